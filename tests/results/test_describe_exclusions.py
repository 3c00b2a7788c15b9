"""What the log says of excluded cells: how many, why, and where."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ddic.mesh.mesh import Mesh
from ddic.parallel.field import ByView
from ddic.parallel.team import Team
from ddic.problem.residual_model import ResidualModel
from ddic.synth.fields import Translation
from ddic.visibility.cell_errors import MOST_PLACES, describe_exclusions, find_marked_cells
from ddic.visibility.exclusions import BLANK, HELD_OFF, SPOILT, UNSEEN, Exclusions
from support.one_subdomain import model_of
from support.pictures import pair_of, source, square_mesh

MESH = square_mesh(24.0, 120.0)
"""6 x 6 cells of 16 px."""

PAIR = pair_of(Translation((0.0, 0.0)), 144, 8)


def describe(states: dict[int, int], pixels: int = 0, mesh: Mesh = MESH) -> tuple[str, ...]:
    model: ResidualModel = model_of(source(PAIR.reference), source(PAIR.deformed), mesh)
    cells = np.zeros(mesh.n_cells, dtype=np.uint8)
    for cell, state in states.items():
        cells[cell] = state
    spots = np.stack([30 + np.arange(pixels), np.full(pixels, 30)], axis=1).astype(np.int64)
    excluded = replace(Exclusions.of_reference(model.views), cells=ByView([[cells]]), pixels=ByView([[spots]]))
    marked = find_marked_cells(Team.alone(), model.subdomains, excluded)
    return describe_exclusions(Team.alone(), marked, mesh.n_cells, excluded)


def cell_at(x: float, y: float, mesh: Mesh = MESH) -> int:
    return int(np.abs(mesh.centroids - (x, y)).sum(axis=1).argmin())


def test_nothing_is_said_of_nothing() -> None:
    assert describe({}) == ()


def test_count_reason_and_place_are_named() -> None:
    states = {cell_at(32, 32): SPOILT, cell_at(48, 32): SPOILT, cell_at(112, 112): BLANK}
    spoilt, blank, pixels = describe(states, 5)
    assert spoilt == ('2 of 36 cells show something else than the reference and are excluded (cell field "excluded"): '
                      "columns 24 to 56, rows 24 to 40")
    assert blank == ('1 of 36 cells have no texture and are excluded (cell field "excluded"): '
                     "columns 104 to 120, rows 104 to 120")
    assert pixels == "5 pixels of other cells show something else than the reference and are excluded"
    (held_off,) = describe({0: HELD_OFF})
    assert held_off.startswith("1 of 36 cells are held by the regularization beside where the images show them")
    assert "regularization.cut_off_wavelength" in held_off
    (unseen,) = describe({0: UNSEEN})
    assert "1 of 36 cells hold no or too few pixels that both images show" in unseen


def test_places_are_apart_where_cells_do_not_touch_and_the_largest_is_first() -> None:
    # Two that touch at a corner, and one with a cell between.
    states = {cell_at(32, 32): SPOILT, cell_at(64, 64): SPOILT, cell_at(80, 80): SPOILT}
    (line,) = describe(states)
    assert line.endswith("columns 56 to 88, rows 56 to 88; columns 24 to 40, rows 24 to 40")


def test_no_more_places_are_named_than_a_line_bears() -> None:
    far_apart = [cell_at(32 + 32 * i, 32 + 32 * j) for i in range(3) for j in range(2)]
    (line,) = describe(dict.fromkeys(far_apart, SPOILT))
    assert line.count("columns") == MOST_PLACES
    assert line.endswith(f"{6 - MOST_PLACES} more places")


@pytest.mark.parametrize("stretch", [(0.25, 1.0), (1.0, 0.25)])
def test_cells_that_touch_are_one_place_whatever_their_shape(stretch: tuple[float, float]) -> None:
    mesh = Mesh((MESH.nodes - 24.0) * stretch + 24.0, MESH.connectivity, MESH.offsets, MESH.types)
    (line,) = describe({0: SPOILT, 1: SPOILT, 6: SPOILT, 7: SPOILT}, mesh=mesh)
    assert line.count("columns") == 1
    # And those with a cell between them are two.
    for other in (2, 12):
        (line,) = describe({0: SPOILT, other: SPOILT}, mesh=mesh)
        assert line.count("columns") == 2
