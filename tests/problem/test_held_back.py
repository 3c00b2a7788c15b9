"""Cells that mechanics hold back: found from where the start put them, and their forces linearized there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ddic.problem.exclusions import HELD_BACK, KEPT, SPOILT, Exclusions
from ddic.problem.held_back import (
    DISPLACED,
    SeenStart,
    find_displaced_cells,
    find_held_cells,
    find_shown_cells,
    linearize_held_cells,
)
from ddic.problem.residual_model import ResidualModel
from ddic.problem.seen_cells import SeenCells, collect_cells, find_typical_cell, measure_seen_cells
from ddic.synth.fields import Translation
from support.one_subdomain import model_of
from support.pictures import pair_of, source, square_mesh

Array = NDArray[np.float64]
MESH = square_mesh(24.0, 88.0)
MOVED = Translation((0.3, -0.2))
TRUTH = np.tile([0.3, -0.2], MESH.n_nodes)
HIDDEN = 5


def build_model(*, hidden: bool = False) -> ResidualModel:
    """Of 16 cells of 16 px; a grey square may hide one in the deformed image."""
    pair = pair_of(MOVED, 128, 8)
    deformed = pair.deformed.copy()
    if hidden:
        (left, top), (right, bottom) = (MESH.nodes[MESH.connectivity.reshape(-1, 4)[HIDDEN]].astype(int).min(axis=0),
                                        MESH.nodes[MESH.connectivity.reshape(-1, 4)[HIDDEN]].astype(int).max(axis=0))
        deformed[top:bottom, left:right] = 128
    return model_of(source(pair.reference), source(deformed), MESH)


def look(model: ResidualModel, q: Array) -> list[list[SeenCells]]:
    slopes = [[view.view.measure_slopes() for view in of_subdomain.views] for of_subdomain in model.views]
    return measure_seen_cells(model, model.evaluate([q]), slopes)


def see_at_truth(model: ResidualModel) -> SeenStart:
    seen = look(model, TRUTH)
    typical = {camera: find_typical_cell(cells) for camera, cells in collect_cells(model, seen).items()}
    return SeenStart(model, model.evaluate([TRUTH]), [TRUTH], typical, find_shown_cells(model.views, seen, typical))


def hold(model: ResidualModel, cells: list[int]) -> Exclusions:
    states = np.full(16, KEPT, dtype=np.uint8)
    states[cells] = HELD_BACK
    return replace(Exclusions.nothing(model.views), cells=[(states,)])


def test_cells_that_left_where_they_were_seen_and_stand_out_are_held_back() -> None:
    model = build_model()
    start = see_at_truth(model)
    assert start.is_shown[0][0].all()
    # Nodes of the last column of cells are moved, hence two columns of nodes, and half of the column of cells before.
    shifts = np.where(MESH.nodes[:, 0] > 70.0, 1.0, 0.0)
    for share, expected in ((1.1, True), (0.9, False)):
        q = (TRUTH.reshape(-1, 2) + share * DISPLACED * np.column_stack([shifts, np.zeros_like(shifts)])).ravel()
        displaced = find_displaced_cells(start, [q])[0][0]
        np.testing.assert_array_equal(displaced, (MESH.centroids[:, 0] > 70.0) & expected)
        # A third of a pixel is believed.
        assert not find_held_cells(start, [q], look(model, q))[0][0].any()
    # Two pixels off is other speckle, but for a cell of few edges across the way.
    q = (TRUTH.reshape(-1, 2) + np.array([2.0, 2.0])).ravel()
    assert find_held_cells(start, [q], look(model, q))[0][0].sum() >= 12


def test_a_cell_that_the_start_did_not_show_is_not_held_back() -> None:
    model = build_model(hidden=True)
    start = see_at_truth(model)
    assert not start.is_shown[0][0][HIDDEN]
    assert start.is_shown[0][0].sum() >= 12
    q = TRUTH + 1.5
    assert not find_held_cells(start, [q], look(model, q))[0][0][HIDDEN]


def test_at_the_start_b_is_that_of_the_images() -> None:
    model = build_model()
    linearized = linearize_held_cells(model, hold(model, [2, 3, 9]), see_at_truth(model))
    (b,), _ = model.linearize([TRUTH])
    (of_linearized,), _ = linearized.linearize([TRUTH])
    np.testing.assert_allclose(of_linearized, b, atol=1e-10 * np.abs(b).max())


def test_elsewhere_the_pull_of_linearized_cells_is_linear_and_the_others_is_that_of_the_images() -> None:
    model = build_model()
    start = see_at_truth(model)
    step = np.random.default_rng(3).normal(0.0, 2.0, MESH.n_dofs)
    everything = linearize_held_cells(model, hold(model, list(range(16))), start)
    (b_0,), _ = model.linearize([TRUTH])
    hessian = model.views[0].views[0].view.assemble_hessian()
    assert everything.linearized is not None
    (pull,) = everything.linearized.compute_forces([TRUTH + step])
    np.testing.assert_allclose(pull, b_0 - hessian @ step, atol=1e-10 * np.abs(hessian @ step).max())
    # Cells of other nodes: a kept one pulls as ever.
    linearized = linearize_held_cells(model, hold(model, [0]), start)
    (b,), _ = model.linearize([TRUTH + step])
    (of_linearized,), _ = linearized.linearize([TRUTH + step])
    beside = np.unique(MESH.connectivity.reshape(-1, 4)[0])
    others = np.setdiff1d(np.arange(MESH.n_nodes), beside)
    np.testing.assert_allclose(of_linearized.reshape(-1, 2)[others], b.reshape(-1, 2)[others], atol=1e-12)
    assert np.abs(of_linearized - b).reshape(-1, 2)[beside].max() > 1e-3 * np.abs(b).max()


def test_nothing_is_linearized_where_nothing_is_held_back() -> None:
    model = build_model()
    start = see_at_truth(model)
    excluded = replace(Exclusions.nothing(model.views), cells=[(np.full(16, SPOILT, dtype=np.uint8),)])
    assert linearize_held_cells(model, excluded, start).linearized is None
    linearized = linearize_held_cells(model, hold(model, [1]), start)
    assert linearize_held_cells(linearized, excluded, start).linearized is None
