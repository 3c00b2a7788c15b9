"""Tip functions: what they span about a crack's tip, and that they end where they should."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ddic.functionals.line_band import weigh_corners
from ddic.functionals.regularization import Material, assemble_stiffness
from ddic.kinematics.enriched import EnrichedRegion, enrich
from ddic.kinematics.tip_functions import (
    N_FUNCTIONS,
    TipPatch,
    enrich_at_tips,
    evaluate_tip_functions,
    find_bends_at_tips,
    find_tips,
)
from ddic.mesh.cut_mesh import cut_mesh, find_points_on_own_side
from ddic.mesh.interpolation import interpolate
from ddic.mesh.mesh import Mesh
from ddic.mesh.quality import measure_cell_size
from ddic.mesh.raster import rasterize
from ddic.mesh.structured import build_structured_mesh

MESHES = {kind: build_structured_mesh((20, 20, 180, 180), 16, kind) for kind in ("Q4", "T3")}
LINES = {"inclined": np.array([[0.0, 71.3], [103.2, 107.9]]),
         # Through nodes of the small cells, and of all cells.
         "along the small cells": np.array([[0.0, 106.0], [103.0, 106.0]]),
         "through nodes": np.array([[0.0, 0.0], [93.0, 93.0]])}
CASES = [(kind, line) for kind in MESHES for line in LINES]


def _enrich(kind: str, line: str) -> tuple[Mesh, TipPatch, EnrichedRegion, EnrichedRegion, np.ndarray]:
    mesh = MESHES[kind]
    patch = find_tips(mesh, [LINES[line]], [True])
    assert patch is not None
    cut = cut_mesh(mesh, [LINES[line]], patch.small.nodes)
    sides = enrich(cut, weigh_corners(cut.mesh, cut.find_cells_at_phantoms(), 3), ["both"])
    return mesh, patch, sides, *enrich_at_tips(cut, sides, patch)


def test_only_ends_inside_are_tips() -> None:
    assert find_tips(MESHES["Q4"], [np.array([[0.0, 71.0], [300.0, 80.0]])], [True]) is None
    patch = find_tips(MESHES["Q4"], [np.array([[60.0, 71.0], [130.0, 80.0]]), LINES["inclined"]], [True, True])
    assert patch is not None
    np.testing.assert_allclose([tip.position for tip in patch.tips], [[60.0, 71.0], [130.0, 80.0], [103.2, 107.9]])
    assert patch.tips[0].ahead[0] < 0 < patch.tips[1].ahead[0]
    assert [len(tip.cells) for tip in patch.tips] == [9, 9, 9]


@pytest.mark.parametrize(("kind", "line"), CASES)
def test_in_the_tips_own_cell_the_functions_are_exact(kind: str, line: str) -> None:
    """With u_a = F(x_a) and amplitudes of 1, sum N_a u_a + sum N_a (F - F(x_a)) = F, on both faces."""
    mesh, patch, sides, region, cell_of = _enrich(kind, line)
    (tip,) = patch.tips
    assert region.mesh.parts is not None
    # The line was moved off nodes.
    tip = replace(tip, position=region.mesh.parts.lines.polylines[0][-1])
    # A unit of an amplitude is about a pixel.
    amplitude = np.sqrt(measure_cell_size(mesh))
    small = region.mesh
    own_side = find_points_on_own_side(small)
    in_tip_cell = [cell for cell in np.unique(cell_of) if set(tip.nodes) <= set(mesh.cells[cell].tolist())]
    (tip_cell,) = in_tip_cell
    nodes = np.unique(small.cells[cell_of == tip_cell])
    nodes = nodes[nodes >= 0]
    for j in range(N_FUNCTIONS):
        for component in range(2):
            q = np.zeros(region.n_unknowns)
            for place, node in enumerate(tip.nodes):
                at_node = mesh.nodes[[node]]
                q[node * 2 + component] = evaluate_tip_functions(tip, at_node, at_node)[0, j]
                q[sides.n_unknowns + (place * N_FUNCTIONS + j) * 2 + component] = amplitude
            u = (region.matrix @ q).reshape(-1, 2)[nodes]
            expected = np.zeros_like(u)
            expected[:, component] = evaluate_tip_functions(tip, small.nodes[nodes], own_side[nodes])[:, j]
            np.testing.assert_allclose(u, expected, atol=1e-10)


@pytest.mark.parametrize(("kind", "line"), CASES)
def test_each_face_opens_to_its_own_side(kind: str, line: str) -> None:
    """Behind the tip, root of r times sin(theta / 2) has the sign of the side that a cell lies on, at all its nodes."""
    _, patch, sides, region, cell_of = _enrich(kind, line)
    assert region.mesh.parts is not None
    # The line was moved off nodes.
    tip = replace(patch.tips[0], position=region.mesh.parts.lines.polylines[0][-1])
    q = np.zeros(region.n_unknowns)
    for place, node in enumerate(tip.nodes):
        at_node = region.mesh.nodes[[node]]
        q[node * 2] = evaluate_tip_functions(tip, at_node, at_node)[0, 0]
        q[sides.n_unknowns + place * N_FUNCTIONS * 2] = np.sqrt(measure_cell_size(MESHES[kind]))
    u = (region.matrix @ q).reshape(-1, 2)[:, 0]
    across = np.array([-tip.ahead[1], tip.ahead[0]])
    checked = 0
    for cell in np.flatnonzero(np.isin(cell_of, tip.cells)):
        centre = region.mesh.centroids[cell] - tip.position
        # Small cells that end more than two of their own behind the tip.
        if centre @ tip.ahead > -4.0 or abs(centre @ across) > 2.0:
            continue
        nodes = region.mesh.cells[cell]
        opened = u[nodes[nodes >= 0]] * np.sign(centre @ across)
        # Times the sum of the tip's shape functions, which is zero at the edge of the small cells.
        assert opened.min() > -1e-12
        checked += opened.max() > 0.1
    assert checked > 10


def test_bends_beside_a_tip_are_found() -> None:
    bent = np.array([[0.0, 60.0], [90.0, 95.0], [103.2, 96.0]])
    np.testing.assert_array_equal(find_bends_at_tips(MESHES["Q4"], bent), bent[1:2])
    far = np.array([[0.0, 60.0], [40.0, 80.0], [103.2, 96.0]])
    assert len(find_bends_at_tips(MESHES["Q4"], far)) == 0


@pytest.mark.parametrize(("kind", "line"), CASES)
def test_displacements_hang_together_at_the_edge_of_the_small_cells(kind: str, line: str) -> None:
    mesh, patch, _, region, cell_of = _enrich(kind, line)
    (tip,) = patch.tips
    q = np.random.default_rng(0).standard_normal(region.n_unknowns)
    u = (region.matrix @ q).reshape(-1, 2)
    is_small = np.isin(cell_of, tip.cells)
    (inner, of_inner), (outer, of_outer) = (region.mesh.create_submesh(np.flatnonzero(chosen))
                                            for chosen in (is_small, ~is_small))
    corners = mesh.nodes[np.setdiff1d(mesh.cells[tip.cells], tip.nodes)]
    shares = np.random.default_rng(1).uniform(0, 1, (40, 1))
    points = np.concatenate([a + shares * (b - a) for a in corners for b in corners if np.linalg.norm(a - b) < 16.1])
    one, other = interpolate(inner, u[of_inner], points), interpolate(outer, u[of_outer], points)
    shared = np.isfinite(one).all(axis=1) & np.isfinite(other).all(axis=1)
    assert shared.sum() > 300
    # Interpolation between small nodes is exact on a side, where the functions vanish.
    np.testing.assert_allclose(one[shared], other[shared], atol=1e-10)


@pytest.mark.parametrize(("kind", "line"), CASES)
def test_pixels_and_stiffness_are_those_of_the_whole_cells(kind: str, line: str) -> None:
    mesh, _, sides, region, cell_of = _enrich(kind, line)
    counts = np.bincount(cell_of, weights=rasterize(region.mesh).pixel_counts)
    np.testing.assert_array_equal(counts, rasterize(mesh).pixel_counts)
    material = Material()
    before = sides.matrix.T @ assemble_stiffness(sides.mesh, material) @ sides.matrix
    after = region.matrix.T @ assemble_stiffness(region.mesh, material) @ region.matrix
    n = sides.n_unknowns
    # Small cells integrate the same shape functions; squares of bilinear ones exactly.
    assert abs(after[:n, :n] - before).max() < 1e-9
    assert after[n:, n:].diagonal().min() > 1e-3
