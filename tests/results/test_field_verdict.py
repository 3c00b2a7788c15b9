"""Verdicts: what speaks against a field, on counts and on pairs of which the answer is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import ddic
from ddic.io.result_schema import DISTRUST, LOOK, TRUST
from ddic.parallel.field import ByView
from ddic.parallel.team import Team
from ddic.results.verdict import Evidence, choose_verdict, find_tear
from ddic.synth.fields import Translation
from ddic.visibility.cell_errors import MarkedCells
from ddic.visibility.exclusions import BLANK, HELD_OFF, MASKED, SPOILT, UNSEEN, Exclusions
from support import spoilt
from support.pictures import pair_of, source, square_mesh
from support.split_model import split_model

PLACE = "columns 24 to 56, rows 24 to 40"


def marked(state: int, n_cells: int) -> MarkedCells:
    return MarkedCells(state, n_cells, PLACE)


def test_a_field_that_nothing_speaks_against_is_trusted() -> None:
    verdict = choose_verdict(Evidence(1000, 0))
    assert (verdict.word, verdict.reasons) == (TRUST, ())
    assert verdict.describe() == "trust this field"
    # Real images have some doubtful cells at edges.
    assert choose_verdict(Evidence(1000, 20)).word == TRUST
    assert choose_verdict(Evidence(1000, 21)).word == LOOK


@pytest.mark.parametrize(("state", "remedy"), [(BLANK, "comes before y"), (SPOILT, "what hides the specimen"),
                                               (UNSEEN, "leaves the image there"), (HELD_OFF, "cut_off_wavelength")])
def test_a_few_marked_cells_are_a_place_to_look_at(state: int, remedy: str) -> None:
    verdict = choose_verdict(Evidence(1000, 3, [marked(state, 3)]))
    assert verdict.word == LOOK
    (reason,) = verdict.reasons
    assert reason.startswith("3 of 1000 cells ")
    assert remedy in reason
    assert PLACE in reason
    assert verdict.describe() == f"look before you trust this field: {reason}"


@pytest.mark.parametrize(("evidence", "why"), [
    (Evidence(1000, 501, [marked(BLANK, 501)]), "50% of the cells are excluded or doubtful"),
    (Evidence(1000, 0, shown_share=0.49), "only 49% of the cells are seen"),
    (Evidence(1000, 60, [marked(SPOILT, 60)], is_torn=True), "[[discontinuity]]"),
    (Evidence(1000, 0, [marked(HELD_OFF, 51)]), "holds 5% of the cells off"),
])
def test_a_field_that_is_mostly_unknown_or_torn_is_not_trusted(evidence: Evidence, why: str) -> None:
    verdict = choose_verdict(evidence)
    assert verdict.word == DISTRUST
    assert why in verdict.reasons[0]
    # Where it is stays part of it.
    assert [PLACE in reason for reason in verdict.reasons[1:]] == [True] * len(evidence.marked)
    assert verdict.describe().startswith("do not trust this field: ")


def test_bounds_are_not_reached_by_what_lies_below_them() -> None:
    assert choose_verdict(Evidence(1000, 500, [marked(BLANK, 500)], shown_share=0.5)).word == LOOK
    assert choose_verdict(Evidence(1000, 0, [marked(HELD_OFF, 50)])).word == LOOK


def test_a_tenth_of_the_cells_may_be_masked() -> None:
    assert choose_verdict(Evidence(1000, 100, [marked(MASKED, 100)], shown_share=0.9)).word == TRUST
    much = choose_verdict(Evidence(1000, 101, [marked(MASKED, 101)], shown_share=0.899))
    assert much.word == LOOK
    assert "101 of 1000 cells hold no pixel of the reference image that counts" in much.reasons[0]
    # Who leaves saturated pixels out has not said where.
    assert choose_verdict(Evidence(1000, 1, [marked(MASKED, 1)], may_be_saturated=True)).word == LOOK


@pytest.mark.parametrize(("n_doubtful", "others", "shown_share", "word"), [
    (600, [], 0.4, LOOK), (801, [marked(BLANK, 201)], 0.4, DISTRUST), (600, [], 0.19, DISTRUST),
    (600, [marked(HELD_OFF, 21)], 0.4, DISTRUST)])
def test_of_other_cells_the_shares_are_as_without_a_mask(
        n_doubtful: int, others: list[MarkedCells], shown_share: float, word: str) -> None:
    """600 of 1000 are masked: bounds are shares of the 400 others."""
    assert choose_verdict(Evidence(1000, n_doubtful, [marked(MASKED, 600), *others], shown_share)).word == word


def test_a_few_doubtful_ones_of_the_others_are_told() -> None:
    assert choose_verdict(Evidence(100, 12, [marked(MASKED, 10)])).word == LOOK
    assert choose_verdict(Evidence(100, 11, [marked(MASKED, 10)])).word == TRUST


def test_what_did_not_converge_is_not_trusted_and_says_why() -> None:
    verdict = choose_verdict(Evidence(1000, 0), "no convergence\n after 50 iterations")
    assert (verdict.word, verdict.reasons) == (DISTRUST, ("no convergence after 50 iterations",))


def test_the_same_image_twice_is_told() -> None:
    verdict = choose_verdict(Evidence(1000, 0, residual=9e-7))
    assert verdict.word == LOOK
    assert "is it the right file?" in verdict.reasons[0]


MESH = square_mesh(32.0, 192.0)
"""10 x 10 cells of 16 px."""

PAIR = pair_of(Translation((0.0, 0.0)), 224, 16)


def is_torn(team: Team, states: dict[tuple[int, int], int]) -> bool:
    """Whether states of cells, by column and row of the mesh, part it, cut into 3 x 2 subdomains on all ranks."""
    model = split_model(team, source(PAIR.reference), source(PAIR.deformed), MESH, (3, 2))
    cells = []
    for subdomain in model.subdomains:
        columns, rows = np.floor((subdomain.mesh.centroids - 32.0) / 16.0).astype(int).T.tolist()
        cells.append([np.array([states.get(place, 0) for place in zip(columns, rows, strict=True)], np.uint8)])
    excluded = replace(Exclusions.of_reference(model.views), cells=ByView(cells))
    return find_tear(team, model.subdomains, excluded)


@pytest.mark.parallel([1, 2, 3, 4])
def test_a_band_from_edge_to_edge_parts_the_mesh_on_any_number_of_ranks() -> None:
    team = Team.world()
    band = {(column, 4): SPOILT for column in range(10)}
    assert is_torn(team, band)
    # Cells that hold no pixel any more are a part of it, a crack that turns too.
    stairs = {(column, 2 + column // 2): UNSEEN for column in range(10)}
    stairs |= {(column, 3 + column // 2): SPOILT for column in range(10)}
    assert is_torn(team, stairs)


@pytest.mark.parallel([1, 3])
def test_what_ends_in_the_mesh_or_cuts_off_a_corner_parts_nothing() -> None:
    team = Team.world()
    assert not is_torn(team, {})
    # Not even where the way round it leads through other subdomains.
    assert not is_torn(team, {(column, 4): SPOILT for column in range(9)})
    corner = {(0, 2): SPOILT, (1, 2): SPOILT, (2, 2): SPOILT, (2, 1): SPOILT, (2, 0): SPOILT}
    assert not is_torn(team, corner)
    # Nor does a band that bears no pattern.
    assert not is_torn(team, {(column, 4): BLANK for column in range(10)})


def test_a_measurement_carries_its_verdict() -> None:
    clean, hidden = spoilt.clean(), spoilt.hide((100, 90, 150, 140))
    trusted = ddic.measure(clean.pair, spoilt.MESH)
    assert trusted.verdict is not None
    assert trusted.verdict.word == TRUST
    looked_at = ddic.measure(hidden.pair, spoilt.MESH)
    assert looked_at.verdict is not None
    assert looked_at.verdict.word == LOOK
    assert "show something else than the reference" in looked_at.verdict.describe()
    same = ddic.measure((clean.reference, clean.reference), spoilt.MESH)
    assert same.verdict is not None
    assert same.verdict.word == LOOK


def test_products_carry_a_verdict_too() -> None:
    options = {"pgd": {}, "mesh": {"structured": {"region": [32, 32, 224, 224], "element_size": 16}}}
    trusted = ddic.measure(spoilt.clean().pair, **options)
    assert trusted.verdict is not None
    assert trusted.verdict.word == TRUST
