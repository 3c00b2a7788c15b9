"""Meshes cut by lines: pixels, areas and which nodes hang together."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from ddic.kinematics.strain import compute_displacement_gradients
from ddic.mesh.cell_parts import place_quadrature_points
from ddic.mesh.cut_mesh import CutMesh, cut_mesh, find_points_on_own_side
from ddic.mesh.interpolation import interpolate
from ddic.mesh.mesh import Mesh, join_meshes
from ddic.mesh.plane import find_nearest_segments, is_inside_polygon, measure_distance, multiply_across
from ddic.mesh.quality import measure_areas
from ddic.mesh.raster import rasterize
from ddic.mesh.structured import build_structured_mesh

LOW, HIGH, SIZE = 20.0, 180.0, 16.0
MESHES = {kind: build_structured_mesh((LOW, LOW, HIGH, HIGH), SIZE, kind) for kind in ("Q4", "T3")}
COORDINATES = st.floats(-20, 220)
POINTS = st.tuples(COORDINATES, COORDINATES)
LINES = st.lists(POINTS, min_size=2, max_size=4, unique=True).map(np.array)


def _count_pieces(mesh: Mesh) -> int:
    """Number of pieces of a mesh that have no node in common."""
    cell_of_corner = np.repeat(np.arange(mesh.n_cells), np.diff(mesh.offsets))
    incidence = sparse.csr_matrix((np.ones(len(cell_of_corner)), (cell_of_corner, mesh.connectivity)))
    return int(connected_components(incidence @ incidence.T)[0])


def _areas_of_outlines(mesh: Mesh) -> NDArray[np.float64]:
    outlines = mesh.outlines
    areas = []
    for begin, end in zip(outlines.offsets[:-1], outlines.offsets[1:], strict=True):
        corners = outlines.corners[outlines.connectivity[begin:end]]
        following = np.roll(corners, -1, axis=0)
        areas.append(0.5 * multiply_across(corners, following).sum())
    return np.array(areas)


@pytest.mark.parametrize("kind", MESHES)
@given(lines=st.lists(LINES, min_size=1, max_size=3))
def test_parts_share_out_pixels_and_areas_of_their_cells(kind: str, lines: list[NDArray[np.float64]]) -> None:
    mesh = MESHES[kind]
    cut = cut_mesh(mesh, lines)
    counts = rasterize(cut.mesh).pixel_counts
    np.testing.assert_array_equal(np.bincount(cut.cell_of, counts), rasterize(mesh).pixel_counts)
    areas = _areas_of_outlines(cut.mesh)
    assert (areas > 0).all()
    # Corners of 200 px are known to 3e-14, areas of 256 square px to some 1e-11.
    np.testing.assert_allclose(np.bincount(cut.cell_of, areas), measure_areas(mesh), atol=1e-10)
    np.testing.assert_array_equal(cut.node_of[:mesh.n_nodes], np.arange(mesh.n_nodes))
    np.testing.assert_array_equal(cut.mesh.nodes, mesh.nodes[cut.node_of])
    np.testing.assert_array_equal(cut.node_of[cut.mesh.cells], np.where(
        mesh.cells < 0, cut.node_of[-1], mesh.cells)[cut.cell_of])


@pytest.mark.parametrize("kind", MESHES)
@given(angle=st.floats(0, 180), offset=st.floats(-60, 60))
def test_line_through_the_mesh_makes_two_pieces(kind: str, angle: float, offset: float) -> None:
    direction = np.array([np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))])
    normal = np.array([-direction[1], direction[0]])
    middle = np.array([100.0, 100.0]) + offset * normal
    line = np.stack([middle - 400 * direction, middle + 400 * direction])
    cut = cut_mesh(MESHES[kind], [line])
    assert _count_pieces(cut.mesh) == 2
    # The sides do not mix: every cell lies on one side of the line, but for the clearance by which it may be moved.
    heights = (cut.mesh.outlines.corners - middle) @ normal
    for begin, end in zip(cut.mesh.outlines.offsets[:-1], cut.mesh.outlines.offsets[1:], strict=True):
        of_cell = heights[cut.mesh.outlines.connectivity[begin:end]]
        assert of_cell.max() < 0.25 or of_cell.min() > -0.25


@pytest.mark.parametrize("kind", MESHES)
def test_line_that_ends_inside_opens_behind_its_end_only(kind: str) -> None:
    mesh = MESHES[kind]
    line = np.array([[0.0, 91.3], [101.0, 101.7]])
    cut = cut_mesh(mesh, [line])
    assert _count_pieces(cut.mesh) == 1
    phantoms = cut.mesh.nodes[mesh.n_nodes:]
    assert len(phantoms)
    # The cell that holds the end is not cut; nodes of its sides are those of the cell behind, ahead nothing has two.
    assert phantoms[:, 0].max() <= 100.0
    assert cut_mesh(mesh, [np.array([[90.0, 95.0], [95.0, 99.0]])]).mesh is mesh


@pytest.mark.parametrize("row", [LOW + 3 * SIZE, LOW + 3 * SIZE + 1e-5])
def test_line_along_element_edges_is_moved_off_the_nodes(row: float) -> None:
    cut = cut_mesh(MESHES["Q4"], [np.array([[0.0, row], [300.0, row]])])
    assert _count_pieces(cut.mesh) == 2
    assert cut.mesh.parts is not None
    (line,) = cut.mesh.parts.lines.polylines
    assert 0 < np.abs(line[:, 1] - row).max() < 0.01
    assert len(cut.cell_of) == MESHES["Q4"].n_cells + 10


def test_crossing_lines_make_four_pieces_and_a_bend_is_cut_straight() -> None:
    mesh = MESHES["Q4"]
    across = [np.array([[0.0, 97.3], [300.0, 101.2]]), np.array([[96.1, 0.0], [103.4, 300.0]])]
    assert _count_pieces(cut_mesh(mesh, across).mesh) == 4
    bent = np.array([[0.0, 60.3], [107.3, 98.1], [101.7, 300.0]])
    assert _count_pieces(cut_mesh(mesh, [bent]).mesh) == 2


def test_displacement_of_each_side_is_found_on_its_side() -> None:
    cut = cut_mesh(MESHES["Q4"], [np.array([[0.0, 50.3], [300.0, 140.2]])])
    normal = np.array([-89.9, 300.0]) / np.hypot(89.9, 300.0)
    is_above = (cut.mesh.centroids - [0.0, 50.3]) @ normal > 0
    values = np.zeros((cut.mesh.n_nodes, 1))
    values[np.unique(cut.mesh.cells[is_above])] = 1.0
    points = np.random.default_rng(0).uniform(LOW, HIGH, (400, 2))
    np.testing.assert_allclose(interpolate(cut.mesh, values, points)[:, 0],
                               ((points - [0.0, 50.3]) @ normal > 0).astype(float), atol=1e-12)


def test_submesh_keeps_its_parts_and_all_lines() -> None:
    cut: CutMesh = cut_mesh(MESHES["T3"], [np.array([[0.0, 50.3], [300.0, 140.2]])])
    whole = cut.mesh
    assert whole.parts is not None
    cells = np.random.default_rng(1).permutation(whole.n_cells)[:90]
    part, _ = whole.create_submesh(cells)
    assert part.parts is not None
    assert 0 < part.parts.n_parts < whole.parts.n_parts
    np.testing.assert_array_equal(rasterize(part).pixel_counts, rasterize(whole).pixel_counts[cells])
    none, _ = whole.create_submesh(np.setdiff1d(np.arange(whole.n_cells), whole.parts.cells)[:5])
    assert none.parts is not None
    assert none.parts.n_parts == 0
    assert len(none.parts.lines.polylines) == 1


def test_quadrature_over_parts_is_exact_to_degree_four() -> None:
    cut = cut_mesh(MESHES["Q4"], [np.array([[0.0, 50.3], [300.0, 140.2]])])
    assert cut.mesh.parts is not None
    points, weights, numbers = place_quadrature_points(cut.mesh.parts)
    parts = cut.mesh.parts
    areas = _areas_of_outlines(cut.mesh)[parts.cells]
    np.testing.assert_allclose(np.bincount(numbers, weights), areas, rtol=1e-12)
    # Green: the integral of x^4 over a polygon is that of x^5 / 5 dy along its outline, exact by three Gauss points.
    nodes, shares = np.polynomial.legendre.leggauss(3)
    x = points[:, 0] - 100.0
    found = np.bincount(numbers, weights * x**4)
    for part in range(parts.n_parts):
        corners = parts.corners[parts.offsets[part]:parts.offsets[part + 1]] - [100.0, 0.0]
        following = np.roll(corners, -1, axis=0)
        total = 0.0
        for node, share in zip(nodes, shares, strict=True):
            along = corners + 0.5 * (1 + node) * (following - corners)
            total += share / 2 * float((along[:, 0]**5 / 5 * (following - corners)[:, 1]).sum())
        assert found[part] == pytest.approx(total, rel=1e-9, abs=1e-4)


def test_distance_from_a_polyline() -> None:
    line = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]])
    points = np.array([[5.0, 3.0], [-3.0, 4.0], [12.0, 5.0], [13.0, -4.0], [9.0, 2.0]])
    np.testing.assert_allclose(measure_distance(points, line), [3.0, 5.0, 2.0, 5.0, 1.0])
    np.testing.assert_array_equal(find_nearest_segments(points, line)[0][[0, 2, 4]], [0, 1, 1])


def test_polygon_need_not_be_convex() -> None:
    arrow = np.array([[0.0, 0.0], [10.0, 5.0], [0.0, 10.0], [4.0, 5.0]])
    points = np.array([[5.0, 5.0], [2.0, 5.0], [1.0, 1.0], [9.0, 9.0], [-1.0, 5.0]])
    np.testing.assert_array_equal(is_inside_polygon(points, arrow), [True, False, True, False, False])


@pytest.mark.parametrize("kind", MESHES)
def test_points_on_a_nodes_own_side_lie_in_its_cells(kind: str) -> None:
    start, normal = np.array([0.0, 50.3]), np.array([-89.9, 300.0])
    mesh = cut_mesh(MESHES[kind], [np.array([[0.0, 50.3], [300.0, 140.2]])]).mesh
    points = find_points_on_own_side(mesh)
    is_above = np.zeros(mesh.n_nodes, dtype=bool)
    cells = mesh.cells[(mesh.centroids - start) @ normal > 0]
    is_above[cells[cells >= 0]] = True
    np.testing.assert_array_equal((points - start) @ normal > 0, is_above)
    moved = (points != mesh.nodes).any(axis=1)
    assert 0 < moved.sum() <= mesh.n_nodes - MESHES[kind].n_nodes
    np.testing.assert_array_equal(find_points_on_own_side(MESHES[kind]), MESHES[kind].nodes)


@pytest.mark.parametrize("lines", [[], [np.array([(0.0, 70.0), (95.0, 84.0)])]], ids=["whole cells", "parts"])
def test_joined_meshes_are_their_cells_one_after_the_other(lines: list[NDArray[np.float64]]) -> None:
    whole = MESHES["Q4"] if not lines else cut_mesh(MESHES["Q4"], lines).mesh
    cells = np.random.default_rng(3).permutation(whole.n_cells)
    meshes = [whole.create_submesh(part)[0] for part in np.array_split(cells, 3)]
    joined = join_meshes(meshes)
    u = [1e-3 * mesh.nodes @ [[3.0, 1.0], [-2.0, 4.0]] + np.sin(mesh.nodes / 30) for mesh in meshes]
    assert join_meshes(meshes[:1]) is meshes[0]
    assert (joined.parts is not None) == (len(lines) > 0)
    np.testing.assert_array_equal(_areas_of_outlines(joined), np.concatenate([_areas_of_outlines(m) for m in meshes]))
    np.testing.assert_array_equal(joined.centroids, np.concatenate([mesh.centroids for mesh in meshes]))
    np.testing.assert_array_equal(rasterize(joined).pixel_counts,
                                  np.concatenate([rasterize(mesh).pixel_counts for mesh in meshes]))
    gradients = [compute_displacement_gradients(mesh, of_mesh.ravel()) for mesh, of_mesh in zip(meshes, u, strict=True)]
    np.testing.assert_allclose(compute_displacement_gradients(joined, np.concatenate(u).ravel()),
                               np.concatenate(gradients), atol=1e-15)
