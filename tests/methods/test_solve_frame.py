"""Frames of which a part is spoilt: what is measured, what is excluded, and the same whatever solves it."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

import ddic
from ddic.visibility.exclusions import BLANK, HELD_OFF, KEPT, SPOILT, UNSEEN
from support.oracles import make_in_turn
from support.spoilt import FIELD, MESH, SIDE, WITHIN, Spoilt, blank_half, blur, change, clean, hide, measure_files, soil

Options = dict[str, Any]
TIGHT: Options = {"tolerance": 1e-13, "rms_tolerance": 1e-9, "max_iterations": 400}
"""Gauss-Newton gains but a third of a digit an iteration beside what is hidden: 1e-9 px of a correction are 3e-9 px."""

TIGHTER: Options = TIGHT | {"rms_tolerance": 1e-10}
"""For methods that take other numbers of iterations. Beside what is hidden single nodes are corrected by more than the
RMS: last corrections of 1e-9, 3e-10 and 1e-10 px leave 1.3e-8, 1.5e-9 and 8e-11 px between fields. Where half is blank,
corrections of less than 1e-9 px are rounding's."""

BLOCKS: Options = {"partition": "blocks", "blocks": [4, 4], "tolerance": 1e-12}
"""16 subdomains of 3 x 3 cells, 48 px wide from column and row 32 on."""

REGULARIZED: Options = {"regularization": {"cut_off_wavelength": 100}}

ACROSS, WHOLE, MANY = (100, 110, 150, 160), (70, 70, 140, 140), (60, 60, 170, 130)
"""Hides parts of four subdomains; all of subdomain 5 and parts of eight others; all of 5 and 6."""

SCENES: Mapping[str, Callable[[], Spoilt]] = {
    "across": lambda: hide(ACROSS), "whole": lambda: hide(WHOLE, "grey"), "many": lambda: hide(MANY, "speckle"),
    "dirt": soil, "blank": blank_half, "blur": lambda: blur(2.5), "clean": clean,
    "beside": lambda: hide((150, 60, 200, 120))}

COMPARED = ("across", "whole", "many", "dirt", "blank", "blur")
"""Scenes on which numbers of ranks are compared."""


def settings(method: str = "dual", *, regularized: bool = False, **more: Any) -> Options:
    solver = BLOCKS | {"method": method}
    return {"solver": solver, "gauss_newton": TIGHT} | (REGULARIZED if regularized else {}) | more


@cache
def measure_scene(name: str, method: str, regularized: bool) -> ddic.Result:
    """On all ranks, with Gauss-Newton's tolerances tight enough for methods to be compared."""
    return ddic.measure(SCENES[name]().pair, MESH, **settings_of(name, method, regularized))


def settings_of(name: str, method: str, regularized: bool) -> Options:
    """Of a scene on which ranks and methods are compared."""
    return settings(method, regularized=regularized, gauss_newton=TIGHT if name == "blank" else TIGHTER)


@cache
def measure_all_alone() -> Mapping[tuple[str, bool], ddic.Result]:
    """Those scenes, without and with regularization, each by the dual method on one rank."""
    cases = list(product(COMPARED, (False, True)))

    def measure_alone(case: tuple[str, bool]) -> ddic.Result:
        name, regularized = case
        return ddic.measure(SCENES[name]().pair, MESH, comm=MPI.COMM_SELF, **settings_of(name, "dual", regularized))

    return dict(zip(cases, make_in_turn(measure_alone, cases), strict=True))


def off(result: ddic.Result) -> NDArray[np.float64]:
    """Errors of nodes, pixels."""
    return np.asarray(np.linalg.norm(result.displacement - FIELD.displacement(MESH.nodes), axis=1))


def largest_difference(one: ddic.Result, other: ddic.Result) -> float:
    np.testing.assert_array_equal(np.isnan(one.displacement), np.isnan(other.displacement))
    np.testing.assert_array_equal(one.fields["excluded"], other.fields["excluded"])
    return float(np.nanmax(np.abs(one.displacement - other.displacement)))


@pytest.mark.parallel([3])
@pytest.mark.parametrize("regularized", [False, True], ids=["plain", "regularized"])
@pytest.mark.parametrize("name", COMPARED)
def test_any_number_of_ranks_finds_the_same(name: str, regularized: bool) -> None:
    found = measure_scene(name, "dual", regularized)
    alone = measure_all_alone()[name, regularized]
    # The same subdomains: sums over ranks round otherwise, and Krylov stops at 1e-12.
    assert largest_difference(found, alone) <= 1e-9
    assert len(found.gauss_newton["iteration"]) == len(alone.gauss_newton["iteration"])


@pytest.mark.parallel([3])
@pytest.mark.parametrize("regularized", [False, True], ids=["plain", "regularized"])
@pytest.mark.parametrize("name", ["across", "whole", "many", "dirt", "blank"])
def test_any_linear_step_finds_the_same(name: str, regularized: bool) -> None:
    # Conjugate gradients have no preconditioner for half a region that texture does not hold.
    methods = ("dual",) if name == "blank" and regularized else ("dual", "conjugate_gradient")
    assembled, *others = (measure_scene(name, method, regularized) for method in ("assembled", *methods))
    # Where half is blank, elements have a brightness of their own, whose slopes are those of
    # the start, which the dual method finds otherwise: 3e-4 px. Nodes between many hidden boxes are known to 0.1 px, in
    # proportion to which Gauss-Newton follows them: 1.4e-5 px. Pixels at the brink of dirt are judged where a field
    # with l_c is roughly found, to 0.01 px: 2 of 35,000 are judged otherwise, or none, which is 2.2e-4 px.
    most = {"blank": 1e-3, "many": 1e-4, "dirt": 1e-3 if regularized else 1e-8}
    assert max(largest_difference(assembled, other) for other in others) <= most.get(name, 1e-8)


@pytest.mark.parametrize("options", [{}, REGULARIZED, {"solver": {"method": "conjugate_gradient"}},
                                     {"correlation": {"grey_correction": "none"}},
                                     {"correlation": {"grey_correction": "element"}}])
def test_nothing_is_excluded_of_a_clean_pair(options: Options) -> None:
    options = {"gauss_newton": TIGHT} | options
    correlation = options.get("correlation", {})
    excluded, kept = (ddic.measure(clean().pair, MESH, **(options | {
        "correlation": correlation | {"spoilt_pixels": what}})) for what in ("exclude", "keep"))
    assert (excluded.fields["excluded"] == KEPT).all()
    assert (kept.fields["excluded"] == KEPT).all()
    assert largest_difference(excluded, kept) <= 1e-6
    assert np.sqrt((off(excluded)**2).mean()) <= WITHIN / 2


@cache
def measure_off_clean(regularized: bool) -> NDArray[np.float64]:
    """Errors of the nodes of a clean pair, with default settings, pixels."""
    return off(ddic.measure(clean().pair, MESH, **(REGULARIZED if regularized else {})))


@pytest.mark.parametrize("regularized", [False, True], ids=["plain", "regularized"])
@pytest.mark.parametrize("kind", ["black", "grey", "speckle"])
@pytest.mark.parametrize("box", [ACROSS, MANY])
def test_what_is_hidden_is_marked_and_spoils_nothing_else(box: tuple[int, int, int, int], kind: str,
                                                          regularized: bool) -> None:
    scene = hide(box, kind)
    result = ddic.measure(scene.pair, MESH, **(REGULARIZED if regularized else {}))
    states, share = result.fields["excluded"], scene.count_hidden()
    # Pixels of cells that are hidden by less count or not one by one.
    assert (states[share > 0.6] != KEPT).all()
    untouched = share == 0
    if not regularized:
        # Cells beside may be weak: they hold a node by few pixels.
        assert (states[untouched] != SPOILT).all()
        untouched &= states == KEPT
    assert (states[untouched] == KEPT).all()
    errors = off(result)
    cells = MESH.connectivity.reshape(-1, 4)
    of_clean = measure_off_clean(regularized)
    beside = np.unique(cells[share > 0])
    far = np.setdiff1d(np.arange(MESH.n_nodes), beside)
    # Where all pixels about a node are seen, it is where it is in a clean pair.
    assert np.abs(errors - of_clean)[far].max() <= WITHIN
    # A node at the edge has a part of its pixels; of a tenth, 3 times the noise, and five deviations.
    assert np.nanmax(errors) <= (0.1 if regularized else 0.35)
    # Not measured is what no pixel and no mechanics hold, and nothing else.
    unheld = np.setdiff1d(np.arange(MESH.n_nodes), np.unique(cells[np.isin(states, (KEPT, HELD_OFF))]))
    expected = np.zeros(MESH.n_nodes, dtype=bool)
    if not regularized:
        assert len(unheld) >= 4
        expected[unheld] = True
    np.testing.assert_array_equal(np.isnan(result.displacement).any(axis=1), expected)


def test_a_result_has_values_beside_what_was_not_measured() -> None:
    result = ddic.measure(hide(ACROSS).pair, MESH)
    is_measured = np.isfinite(result.displacement).all(axis=1)
    assert not is_measured.all()
    found = result.at(MESH.nodes)
    np.testing.assert_allclose(found[is_measured], result.displacement[is_measured], atol=1e-9)
    assert np.isnan(found[~is_measured]).all()
    # On the edge between two nodes that were measured, whichever of the cells there is taken.
    cells = MESH.connectivity.reshape(-1, 4)
    mixed = cells[~is_measured[cells].all(axis=1) & is_measured[cells].any(axis=1)]
    edges = [(c[k], c[(k + 1) % 4]) for c in mixed for k in range(4) if is_measured[c[[k, (k + 1) % 4]]].all()]
    assert edges
    middles = np.array([MESH.nodes[list(edge)].mean(axis=0) for edge in edges])
    expected = np.array([result.displacement[list(edge)].mean(axis=0) for edge in edges])
    np.testing.assert_allclose(result.at(middles), expected, atol=1e-9)


def test_dirt_is_left_out_pixel_by_pixel() -> None:
    scene = soil(16, radius=1)
    excluded, kept = (ddic.measure(scene.pair, MESH, correlation={"spoilt_pixels": what})
                      for what in ("exclude", "keep"))
    of_clean = measure_off_clean(regularized=False)
    # Spots of 3 px and what about them is left out, 4 px on either side, are less than half of a cell.
    assert (excluded.fields["excluded"] == KEPT).all()
    assert np.nanmax(np.abs(off(excluded) - of_clean)) <= WITHIN
    # Guards the test: dirt does spoil.
    assert np.abs(off(kept) - of_clean).max() > 3 * WITHIN


def test_half_a_specimen_without_speckle_is_blank() -> None:
    scene = blank_half()
    result = ddic.measure(scene.pair, MESH)
    states = result.fields["excluded"]
    right = MESH.centroids[:, 0] > SIDE / 2
    assert (states[right] != KEPT).all()
    assert (states[right] == BLANK).mean() > 0.8
    assert (states[~right] == KEPT).all()
    cells = MESH.connectivity.reshape(-1, 4)
    measured = np.unique(cells[~right])
    errors = off(result)
    # Edges of the mesh are 0.07 px off in a clean pair.
    assert errors[measured].max() <= 0.12
    assert np.isnan(np.delete(errors, measured)).all()


def test_a_blurred_frame_is_met_by_a_blurred_reference() -> None:
    errors = {}
    for deviation in (0.0, 2.5):
        result = ddic.measure(blur(deviation).pair if deviation else clean().pair, MESH)
        assert (result.fields["excluded"] == KEPT).all()
        errors[deviation] = np.sqrt((off(result)**2).mean())
    # A blur of 2.5 px along x leaves a third of the slopes along x: noise moves nodes by three times as much there.
    assert errors[2.5] <= 3 * errors[0.0]


@pytest.mark.parametrize("options", [{}, REGULARIZED], ids=["plain", "regularized"])
def test_a_frame_so_blurred_that_noise_hides_every_place_is_no_result(options: Options) -> None:
    with pytest.raises(ddic.ConvergenceError, match=r"noise alone moves nodes of .* by more than 0.15 px") as found:
        ddic.measure(blur(6.0).pair, MESH, **options)
    last = found.value.result
    assert last is not None
    assert not last.converged
    assert (last.fields["doubtful"] != 0).mean() >= 0.95
    # The field that was called converged: noise moves it by whole pixels.
    assert off(last).max() > 0.5


@pytest.mark.parametrize(("change_of_grey", "expected"), [
    (None, "none"), (lambda g: 0.8 * g + 15.0, "global"),
    (lambda g: g * (0.8 + 0.3 * np.arange(SIDE) / SIDE) + 20.0 * (np.arange(SIDE) / SIDE)[:, None], "element")])
def test_auto_takes_the_correction_that_the_pair_needs(change_of_grey: Any, expected: str) -> None:
    scene = clean() if change_of_grey is None else change(change_of_grey)
    automatic, asked = (ddic.measure(scene.pair, MESH, gauss_newton=TIGHT, correlation={
        "grey_correction": correction}) for correction in ("auto", expected))
    if expected == "element":
        # That, and the slope of the light inside elements.
        assert np.sqrt((off(automatic)**2).mean()) <= 0.9 * np.sqrt((off(asked)**2).mean())
    else:
        # As if it had been asked for.
        assert largest_difference(automatic, asked) <= 1e-6
    others = {"none", "global", "element"} - {expected}
    if expected != "none":
        others.remove("none")  # which does not converge, or to another field
    for other in others:
        different = ddic.measure(scene.pair, MESH, gauss_newton=TIGHT, correlation={
            "grey_correction": other, "spoilt_pixels": "keep"})
        assert np.nanmax(np.abs(different.displacement - automatic.displacement)) > 1e-5


@pytest.mark.parallel([3])
@pytest.mark.parametrize("regularized", [False, True], ids=["plain", "regularized"])
def test_frames_of_a_session_equal_separate_measurements(regularized: bool) -> None:
    names = ["across", "clean", "whole", "dirt", "clean", "blur", "beside"]
    with ddic.prepare(clean().reference, MESH, **settings(regularized=regularized)) as session:
        found = [session.measure(SCENES[name]().deformed) for name in names]
    for result, name in zip(found, names, strict=True):
        assert largest_difference(result, measure_scene(name, "dual", regularized)) <= 1e-6


@pytest.mark.parallel([1, 3])
def test_a_frame_starts_from_one_of_which_a_part_was_not_measured() -> None:
    options = settings()
    with ddic.prepare(clean().reference, MESH, **options) as session:
        hidden = session.measure(hide(ACROSS).deformed)
        found = session.measure(clean().deformed, from_last=True)
    assert np.isnan(hidden.displacement).any()
    assert largest_difference(found, ddic.measure(clean().pair, MESH, **options)) <= 1e-6


@pytest.mark.parallel([3])
@pytest.mark.parametrize("name", ["whole", "blank"])
def test_a_measurement_goes_on_from_a_result_of_which_a_part_was_not_measured(name: str) -> None:
    scene, options = SCENES[name](), settings()
    with ddic.prepare(scene.reference, MESH, **options) as session:
        first = session.measure(scene.deformed)
        again = session.measure(scene.deformed, start=first)
        assert np.isnan(first.displacement).any()
        # What is excluded may differ at the limit from where it was before: beside it by hundredths of a pixel.
        both = np.isfinite(first.displacement).all(axis=1) & np.isfinite(again.displacement).all(axis=1)
        assert both.sum() >= 0.95 * np.isfinite(first.displacement).all(axis=1).sum()
        assert np.abs(again.displacement - first.displacement)[both].max() <= WITHIN
        if name == "blank":
            return
        clear = session.measure(clean().deformed, start=first)
    assert largest_difference(clear, ddic.measure(clean().pair, MESH, **options)) <= 1e-6


def test_products_go_on_from_a_result_of_which_a_part_was_not_measured() -> None:
    scene = hide(WHOLE, "grey")
    first = ddic.measure(scene.pair, MESH)
    assert np.isnan(first.displacement).any()
    structured = {"mesh": {"structured": {"region": [32, 32, 224, 224], "element_size": 16}}, "pgd": {}}
    found = ddic.measure(clean().pair, **structured, start=first)
    assert off(found).max() <= 3 * WITHIN


def test_a_frame_that_shows_something_else_altogether_is_refused_with_its_last_field() -> None:
    other = hide((0, 0, SIDE, SIDE), "speckle")
    with pytest.raises(ddic.ConvergenceError) as caught:
        ddic.measure(other.pair, MESH, start={"pyramid": False})
    result = caught.value.result
    assert result is not None
    assert result.displacement.shape == MESH.nodes.shape
    assert not result.converged
    assert "do not show in the deformed image" in str(caught.value)


def test_the_notes_say_what_was_found_and_where(tmp_path: Path) -> None:
    measured, ears = measure_files(tmp_path, hide(MANY))
    states = np.concatenate([of_view for of_subdomain in measured.excluded.cells for of_view in of_subdomain])
    n_spoilt, n_unseen = (int((states == state).sum()) for state in (SPOILT, UNSEEN))
    (line,) = [note for note in ears.notes if "show something else than the reference and are excluded (" in note]
    assert line.startswith(f"{n_spoilt} of 144 cells ")
    # One place, that of what hides them, less the displacement, to a cell.
    x0, x1, y0, y1 = (int(number) for number in re.findall(r"columns (\d+) to (\d+), rows (\d+) to (\d+)", line)[0])
    assert line.count("columns") == 1
    assert np.abs(np.array([x0, y0, x1, y1]) - MANY).max() <= 16
    if n_unseen:
        assert any(note.startswith(f"{n_unseen} of 144 cells hold no or too few") for note in ears.notes)
    assert all(note in ears.notes for note in measured.notes)
    assert sum("follow their neighbours" in note for note in ears.notes) >= 1


def test_the_note_names_the_correction_that_was_chosen_and_none_that_was_asked_for(tmp_path: Path) -> None:
    dim = change(lambda g: 0.8 * g + 15.0)
    measured, ears = measure_files(tmp_path, dim)
    assert measured.grey_correction == "global"
    assert "grey levels: one gain and offset for the whole image, chosen from the pair (correlation.grey_correction)" \
        in ears.notes
    for asked in ("global", "element"):
        measured, ears = measure_files(tmp_path, dim, f'[correlation]\ngrey_correction = "{asked}"\n')
        assert measured.grey_correction == asked
        assert not any("chosen from the pair" in note for note in ears.notes)
    measured, ears = measure_files(tmp_path, clean(), '[correlation]\ngrey_correction = "element"\n')
    assert measured.grey_correction == "element"
    measured, ears = measure_files(tmp_path, clean())
    assert measured.grey_correction == "none"
    assert not any("excluded" in note for note in ears.notes)


def test_a_blur_is_noted_with_its_size(tmp_path: Path) -> None:
    _, ears = measure_files(tmp_path, blur(2.5))
    (line,) = [note for note in ears.notes if "less sharp" in note]
    along, angle, across = (float(number) for number in re.findall(
        r"deviation ([\d.]+) px at (-?\d+) degrees, ([\d.]+) px across", line)[0])
    assert along == pytest.approx(2.5, abs=0.4)
    assert across <= 0.6
    assert abs((angle + 90) % 180 - 90) <= 5
    _, ears = measure_files(tmp_path, clean())
    assert not any("less sharp" in note for note in ears.notes)


@pytest.mark.parametrize("correction", ["auto", "none"])
def test_both_images_are_taken_as_they_are_where_that_is_asked_for(tmp_path: Path, correction: str) -> None:
    # With a blur of 2 px Gauss-Newton still converges without help.
    measured, ears = measure_files(tmp_path, blur(2.0), f'[correlation]\nspoilt_pixels = "keep"\n'
                                                        f'grey_correction = "{correction}"\n')
    assert not any("less sharp" in note for note in ears.notes)
    assert measured.model.blurs == ()
    assert all((of_view == KEPT).all() for of_subdomain in measured.excluded.cells for of_view in of_subdomain)
    # Guards the test: by default that is blurred.
    assert measure_files(tmp_path, blur(2.0))[0].model.blurs


@pytest.mark.parallel([3])
@pytest.mark.parametrize("regularized", [False, True], ids=["plain", "regularized"])
def test_the_start_of_a_hidden_frame_moves_nodes_by_less_than_noise(regularized: bool) -> None:
    options = settings(regularized=regularized)
    corner = hide((0, 0, 66, 66), "grey")
    with ddic.prepare(clean().reference, MESH, **options) as session:
        session.measure(hide(ACROSS).deformed)
        found = session.measure(corner.deformed, from_last=True)
    separate = ddic.measure(corner.pair, MESH, **options)
    assert (found.fields["excluded"] != KEPT).sum() >= 4
    # Pixels at the rim of what is hidden are excluded where a tenth more or less of them would change: those of the
    # first fields stay. 0.009 px were measured, beside the hidden cells.
    is_seen = (MESH.nodes > 84).any(axis=1)
    assert np.abs(found.displacement - separate.displacement)[is_seen].max() <= 0.02
    far = (MESH.nodes > 116).any(axis=1)
    assert np.abs(found.displacement - separate.displacement)[far].max() <= 3e-3
