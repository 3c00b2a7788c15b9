"""Structured meshes: exact cover, round holes, masks."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ddic.errors import InputError
from ddic.images.binned import ArraySource
from ddic.mesh.cell_type import HEX8, Q4, T3
from ddic.mesh.quality import measure_areas, measure_shape_quality
from ddic.mesh.repair import repair
from ddic.mesh.structured import SMALLEST_SINE, build_grid_lines, build_structured_mesh
from ddic.mesh.topology import find_adjacent_cells, find_boundary_facets, find_boundary_nodes, find_facets

Cell = Literal["Q4", "T3"]
SIZE = st.floats(4.0, 30.0)


def test_cells_have_the_size_asked_for() -> None:
    mesh = build_structured_mesh((10, 20, 90, 68), 16)
    assert (mesh.n_cells, mesh.n_nodes) == (5 * 3, 6 * 4)
    np.testing.assert_allclose(measure_areas(mesh), 256.0, rtol=1e-14)
    assert mesh.nodes[0].tolist() == [10, 20]
    assert mesh.nodes[-1].tolist() == [90, 68]


def test_named_sides() -> None:
    mesh = build_structured_mesh((10, 20, 90, 68), 16)
    for name, axis, value in (("left", 0, 10), ("right", 0, 90), ("top", 1, 20), ("bottom", 1, 68)):
        assert mesh.node_sets[name].tolist() == np.flatnonzero(mesh.nodes[:, axis] == value).tolist()


@settings(max_examples=50)
@given(x0=st.floats(-50, 50), y0=st.floats(-50, 50), width=st.floats(30, 300), height=st.floats(30, 300),
       size=SIZE, cell=st.sampled_from(["Q4", "T3"]))
def test_cells_cover_the_region_exactly(x0: float, y0: float, width: float, height: float, size: float,
                                        cell: Cell) -> None:
    mesh = build_structured_mesh((x0, y0, x0 + width, y0 + height), size, cell)
    # A sum of at most a few thousand terms of rounding 1e-16 each, coordinates up to 350.
    np.testing.assert_allclose(measure_areas(mesh).sum(), width * height, rtol=1e-10)
    assert measure_areas(mesh).min() > 0
    # From the region's own sides: x0 + width - x0 may differ from width by a rounding, which decides ties.
    columns, rows = round((x0 + width - x0) / size), round((y0 + height - y0) / size)
    assert mesh.n_cells == columns * rows * (2 if cell == "T3" else 1)
    assert len(find_boundary_nodes(mesh)) == 2 * (columns + rows)


def test_diagonals_of_triangles_alternate() -> None:
    mesh = build_structured_mesh((0, 0, 20, 10), 10, "T3")
    found = find_facets(mesh)
    edges = {tuple(sorted(nodes)) for nodes in found.nodes[found.n_cells == 2].tolist()}
    # Nodes 0 1 2 above 3 4 5: a diagonal from 0 to 4, the other way in the next cell.
    assert edges == {(0, 4), (1, 4), (2, 4)}


@settings(max_examples=60)
@example(cx=60.0, cy=112.0, radius=9.0, size=10.5, cell="T3")
@given(cx=st.floats(60, 140), cy=st.floats(60, 140), radius=st.floats(9, 50), size=st.floats(5, 12),
       cell=st.sampled_from(["Q4", "T3"]))
def test_holes_are_round(cx: float, cy: float, radius: float, size: float, cell: Cell) -> None:
    mesh = build_structured_mesh((0, 0, 200, 200), size, cell, circles=[((cx, cy), radius)])
    found = find_facets(mesh)
    outer = found.nodes[found.n_cells == 1]
    rim = outer[((mesh.nodes[outer] > 0.0) & (mesh.nodes[outer] < 200.0)).all(axis=(1, 2))]
    assert np.isin(rim, mesh.node_sets["hole_0"]).all()
    away = np.abs(np.hypot(*(mesh.nodes[mesh.node_sets["hole_0"]] - [cx, cy]).T) - radius)
    # Nodes that are held back stay near: 0.33 sizes at most over 4000 random circles.
    assert away.max() < 0.5 * size
    assert measure_areas(mesh).min() > 0
    assert measure_shape_quality(mesh).min() >= SMALLEST_SINE
    assert mesh.n_nodes == len(np.unique(mesh.connectivity))


@pytest.mark.parametrize("size", [4.0, 8.0, 16.0])
def test_area_of_a_hole_converges(size: float) -> None:
    mesh = build_structured_mesh((0, 0, 400, 400), size, circles=[((203.0, 191.0), 80.0)])
    hole = 400.0**2 - measure_areas(mesh).sum()
    # Chords of length up to sqrt(2) size each leave out chord^3 / (12 radius): relative (chord/radius)^2 / 6.
    assert 0 <= 1 - hole / (np.pi * 80.0**2) < (np.sqrt(2.0) * size / 80.0) ** 2 / 6


def test_corners_in_a_hole_are_cut_off() -> None:
    mesh = build_structured_mesh((0, 0, 400, 400), 16, circles=[((200.0, 200.0), 80.0)])
    kinds, counts = np.unique(mesh.types, return_counts=True)
    assert kinds.tolist() == [T3.vtk, Q4.vtk]
    assert counts[0] < 0.05 * mesh.n_cells


def test_notch_nodes_slide_along_the_side() -> None:
    mesh = build_structured_mesh((0, 0, 200, 200), 10, circles=[((9.0, 103.0), 37.0)])
    on_left = mesh.node_sets["left"]
    assert (mesh.nodes[on_left, 0] == 0.0).all()
    rim = np.intersect1d(on_left, mesh.node_sets["hole_0"])
    # The centre is inside the region: the nearest point of the circle is not on the side.
    half = np.sqrt(37.0**2 - 9.0**2)
    # Bisection over at most 20 px, 50 halvings: rounding is what is left.
    np.testing.assert_allclose(np.sort(mesh.nodes[rim, 1]), [103.0 - half, 103.0 + half], atol=1e-9)


@pytest.mark.parametrize("cell", ["Q4", "T3"])
def test_nearly_all_nodes_reach_the_circle(cell: Cell) -> None:
    rng = np.random.default_rng(3)
    reached = []
    for _ in range(60):
        center, radius = rng.uniform(60, 140, 2), float(rng.uniform(12, 50))
        mesh = build_structured_mesh((0, 0, 200, 200), 10, cell, circles=[((center[0], center[1]), radius)])
        away = np.hypot(*(mesh.nodes[mesh.node_sets["hole_0"]] - center).T) - radius
        reached += (np.abs(away) < 1e-9).tolist()
    # Measured over 65 398 nodes, small holes included: all but 0.01 % (Q4) and 0.25 % (T3).
    assert np.mean(reached) > 0.99


def test_a_node_that_would_spoil_a_cell_is_held_back() -> None:
    # Found by a search over 300 circles: projecting all nodes of this one leaves a corner with a sine of 0.1.
    center, radius = (258.44400123, 238.08681717), 11.85357679593875
    mesh = build_structured_mesh((0, 0, 400, 400), 16, circles=[(center, radius)])
    away = np.abs(np.hypot(*(mesh.nodes[mesh.node_sets["hole_0"]] - center).T) - radius)
    assert (away > 1e-9).any()
    assert measure_shape_quality(mesh).min() >= SMALLEST_SINE


def test_polygonal_hole() -> None:
    triangle = np.array([[60.0, 60.0], [150.0, 80.0], [80.0, 150.0]])
    mesh = build_structured_mesh((0, 0, 200, 200), 8, polygons=[triangle])
    rim = mesh.nodes[mesh.node_sets["hole_0"]]
    edge = np.roll(triangle, -1, axis=0) - triangle
    offset = rim[:, None, :] - triangle
    away = np.abs(edge[:, 0] * offset[..., 1] - edge[:, 1] * offset[..., 0]) / np.linalg.norm(edge, axis=1)
    assert (away.min(axis=1) < 1e-9).mean() > 0.9
    assert measure_areas(mesh).min() > 0
    inside = 0.5 * abs(np.linalg.det(np.stack([triangle[1] - triangle[0], triangle[2] - triangle[0]])))
    # The corners of the polygon are cut by up to about half a cell each.
    assert 200.0**2 - measure_areas(mesh).sum() == pytest.approx(inside, abs=3 * 64.0)


@settings(max_examples=30)
@given(first=st.tuples(st.floats(40, 160), st.floats(40, 160)), second=st.tuples(st.floats(0, 200), st.floats(0, 200)),
       radius=st.floats(15, 40))
def test_overlapping_holes_leave_sound_cells(first: tuple[float, float], second: tuple[float, float],
                                             radius: float) -> None:
    mesh = build_structured_mesh((0, 0, 200, 200), 10, circles=[(first, radius), (second, 25.0)])
    assert repair(mesh).n_nodes == mesh.n_nodes
    # One hole may have swallowed the other; no edge of the boundary is without a name.
    edges = find_boundary_facets(mesh)[:, :2]
    held = np.array([np.isin(edges, nodes).all(axis=1) for nodes in mesh.node_sets.values()])
    assert held.any(axis=0).all()
    assert measure_areas(mesh).sum() < 200.0**2


def test_mask_keeps_cells_with_half_of_their_pixels() -> None:
    mask = np.zeros((40, 60), dtype=bool)
    mask[:, 25:] = True  # the column of cells 20 <= x < 30 has exactly half of its pixels
    mesh = build_structured_mesh((0, 0, 60, 40), 10, mask=mask)
    assert mesh.nodes[:, 0].min() == 20
    assert mesh.n_cells == 4 * 4
    mask[:, 25] = False
    assert build_structured_mesh((0, 0, 60, 40), 10, mask=mask).n_cells == 4 * 3


def test_pixels_outside_the_mask_image_count_as_false() -> None:
    mask = np.ones((40, 40), dtype=bool)
    mesh = build_structured_mesh((-20, -20, 60, 60), 10, mask=mask)
    assert mesh.nodes.min(axis=0).tolist() == [0, 0]
    assert mesh.nodes.max(axis=0).tolist() == [40, 40]


def test_hole_that_removes_nothing_is_refused() -> None:
    with pytest.raises(InputError, match="hole_1 holds the centre of no cell"):
        build_structured_mesh((0, 0, 100, 100), 10, circles=[((50.0, 50.0), 20.0), ((500.0, 50.0), 20.0)])


def test_nothing_left_is_refused() -> None:
    with pytest.raises(InputError, match="no cell is left"):
        build_structured_mesh((0, 0, 100, 100), 10, mask=np.zeros((100, 100), dtype=bool))


def test_a_large_mesh_is_connected() -> None:
    mesh = build_structured_mesh((0, 0, 300, 300), 10, circles=[((150.0, 150.0), 60.0)])
    indptr, indices = find_adjacent_cells(mesh)
    seen, front = {0}, [0]
    while front:
        cell = front.pop()
        new = set(indices[indptr[cell]:indptr[cell + 1]].tolist()) - seen
        seen |= new
        front += new
    assert len(seen) == mesh.n_cells


def test_a_box_in_a_volume_keeps_the_cells_that_a_mask_holds_for_a_half() -> None:
    rng = np.random.default_rng(4)
    # Larger along each axis than the volume that it is of on one side, and smaller on the other.
    mask = rng.random((20, 24, 22)) < 0.5
    region, size = (-3.0, 1.5, 2.0, 18.6, 22.0, 21.7), 5.0
    mesh = build_structured_mesh(region, size, mask=mask)
    grid = build_grid_lines(region, size)
    kept = []
    for corners in grid.nodes[grid.cells]:
        low, high = (np.ceil(corner).astype(int) for corner in (corners.min(axis=0), corners.max(axis=0)))
        inside = [np.arange(max(a, 0), min(b, n)) for a, b, n in zip(low, high, mask.shape[::-1], strict=True)]
        kept.append(2 * mask[np.ix_(*inside[::-1])].sum() >= np.prod(high - low))
    assert 0 < sum(kept) < grid.n_cells
    np.testing.assert_allclose(mesh.centroids, grid.centroids[kept])
    assert set(mesh.types) == {HEX8.vtk}
    source = ArraySource(Path("mask"), mask.astype(np.uint8))
    np.testing.assert_array_equal(build_structured_mesh(region, size, mask=source).nodes, mesh.nodes)


def test_the_nodes_on_the_faces_of_a_box_have_names() -> None:
    mesh = build_structured_mesh((0, 0, 0, 8, 12, 16), 4)
    for axis, names in enumerate((("left", "right"), ("top", "bottom"), ("front", "back"))):
        for name, place in zip(names, (0.0, 4.0 * (axis + 2)), strict=True):
            expected = np.flatnonzero(mesh.nodes[:, axis] == place)
            assert sorted(mesh.node_sets[name].tolist()) == expected.tolist()
