"""Rasterisation: every pixel centre belongs to exactly one cell."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ddic.images.window import Window
from ddic.mesh.cell_type import T3
from ddic.mesh.mesh import Mesh, build_mesh
from ddic.mesh.raster import SNAP, Raster, rasterize
from ddic.mesh.topology import find_boundary_facets
from support.random_meshes import (
    PARTITIONS,
    SEEDS,
    delaunay_meshes,
    grid_mesh,
    grid_meshes,
    lattice_meshes,
    random_partition,
)

# Crossings are rounded by up to half a step; so much nearer to an edge a pixel may go to either side.
NEAR = 1.0 / SNAP

ANY_MESH = st.one_of(grid_meshes(), delaunay_meshes(), lattice_meshes())


def pixels_of(raster: Raster) -> list[set[tuple[int, int]]]:
    """Pixels (x, y) of each cell."""
    rows = raster.find_runs(np.arange(len(raster.n_rows)))[1][:, 0]
    return [{(x, int(rows[r])) for r in range(raster.row_ptr[e], raster.row_ptr[e + 1])
             for x in range(raster.starts[r], raster.stops[r])} for e in range(len(raster.n_rows))]


def draw_all(raster: Raster, width: int, height: int) -> NDArray[np.uint8]:
    return raster.draw_cells(np.arange(len(raster.n_rows)), Window.of_size(width, height))


def corners(mesh: Mesh, cell: int) -> NDArray[np.float64]:
    return mesh.nodes[mesh.connectivity[mesh.offsets[cell]: mesh.offsets[cell + 1]]]


def pixels_around(mesh: Mesh) -> NDArray[np.float64]:
    low, high = np.floor(mesh.nodes.min(axis=0)) - 1, np.ceil(mesh.nodes.max(axis=0)) + 1
    x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    return np.column_stack([x.ravel(), y.ravel()])


def depth(polygon: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance of points to the nearest line through an edge, negative outside a convex polygon."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    relative = points[:, None] - polygon
    cross = edges[:, 0] * relative[..., 1] - edges[:, 1] * relative[..., 0]
    return np.asarray((cross / np.linalg.norm(edges, axis=1)).min(axis=1))


def distance_to_segments(points: NDArray[np.float64], a: NDArray[np.float64],
                         b: NDArray[np.float64]) -> NDArray[np.float64]:
    along = b - a
    t = np.clip(((points[:, None] - a) * along).sum(-1) / (along**2).sum(-1), 0, 1)
    return np.asarray(np.linalg.norm(points[:, None] - a - t[..., None] * along, axis=2).min(axis=1))


def owned_by_rule(polygon: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether a convex polygon holds points moved by an infinitesimal step right and a much smaller one down.

    Coordinates are multiples of 1/2, so that integers decide exactly.
    """
    ends, places = (2 * polygon).astype(np.int64), (2 * points).astype(np.int64)
    edges = np.roll(ends, -1, axis=0) - ends
    relative = places[:, None] - ends
    cross = edges[:, 0] * relative[..., 1] - edges[:, 1] * relative[..., 0]
    by_step = np.where(edges[:, 1] != 0, -edges[:, 1], edges[:, 0])
    return np.asarray((np.where(cross != 0, cross, by_step) > 0).all(axis=1))


@settings(max_examples=60)
@given(mesh=lattice_meshes())
def test_pixels_on_edges_and_nodes_follow_the_exact_rule(mesh: Mesh) -> None:
    # With nodes on halves of pixels a crossing is a pixel centre exactly or more than NEAR away from it.
    points = pixels_around(mesh)
    for e, pixels in enumerate(pixels_of(rasterize(mesh))):
        expected = points[owned_by_rule(corners(mesh, e), points)]
        assert pixels == {(int(x), int(y)) for x, y in expected}


@pytest.mark.parametrize("slope", [(1, 1), (-1, 1), (3, 1), (-2, 3)])
def test_pixels_on_a_long_edge_follow_the_exact_rule(slope: tuple[int, int]) -> None:
    # Crossings like 1/49 x 49 are a rounding error away from the pixel centre that they hit.
    for d in range(2, 120):
        nodes = np.array([[0, 0], [d * slope[0], d * slope[1]], [-200, 120], [200, -80]], dtype=float)
        mesh = build_mesh(nodes, {T3: np.array([[0, 1, 2], [1, 0, 3]])})
        on_edge = np.arange(d)[:, None] * np.array(slope)
        found = pixels_of(rasterize(mesh))
        for e in range(2):
            expected = owned_by_rule(corners(mesh, e), on_edge)
            assert [(int(x), int(y)) in found[e] for x, y in on_edge] == expected.tolist()


@settings(max_examples=100)
@given(mesh=ANY_MESH)
def test_cells_hold_the_pixels_inside_and_share_none(mesh: Mesh) -> None:
    raster = rasterize(mesh)
    found = pixels_of(raster)
    points = pixels_around(mesh)
    owned = np.array([[(int(x), int(y)) in pixels for x, y in points] for pixels in found])
    depths = np.array([depth(corners(mesh, e), points) for e in range(mesh.n_cells)])
    assert owned.sum(axis=0).max(initial=0) <= 1
    assert owned[depths > NEAR].all()
    assert not owned[depths < -NEAR].any()
    assert raster.pixel_counts.tolist() == [len(pixels) for pixels in found]


@settings(max_examples=100)
@given(mesh=ANY_MESH)
def test_pixels_inside_the_union_belong_to_one_cell(mesh: Mesh) -> None:
    points = pixels_around(mesh)
    sides = mesh.nodes[find_boundary_facets(mesh)]
    inside = np.zeros(len(points), dtype=bool)
    for e in range(mesh.n_cells):
        inside |= depth(corners(mesh, e), points) >= -1e-9
    # Far from the outline a point of a closed cell lies strictly inside, on inner edges and nodes as well.
    inside &= distance_to_segments(points, sides[:, 0], sides[:, 1]) > NEAR
    all_pixels = set().union(*pixels_of(rasterize(mesh)))
    assert all((int(x), int(y)) in all_pixels for x, y in points[inside])


@settings(max_examples=60)
@given(mesh=ANY_MESH, kind=PARTITIONS, n=st.integers(2, 6), seed=SEEDS)
def test_masks_of_a_partition_add_up_to_the_mask_of_the_whole(mesh: Mesh, kind: str, n: int, seed: int) -> None:
    mesh = Mesh(mesh.nodes - np.floor(mesh.nodes.min(axis=0)), mesh.connectivity, mesh.offsets, mesh.types)
    width, height = np.ceil(mesh.nodes.max(axis=0)).astype(int) + 1
    parts = random_partition(mesh, kind, n, seed)
    total = np.zeros((height, width), dtype=int)
    for s in range(int(parts.max()) + 1):
        part, _ = mesh.create_submesh(np.flatnonzero(parts == s))
        total += draw_all(rasterize(part), width, height)
    np.testing.assert_array_equal(total, draw_all(rasterize(mesh), width, height))


def test_half_open_square_takes_its_left_and_top_edges() -> None:
    raster = rasterize(grid_mesh(1, 1, (3.0, 2.0), origin=(5.0, 7.0)))
    assert pixels_of(raster) == [{(x, y) for x in (5, 6, 7) for y in (7, 8)}]
    assert raster.window == Window((5, 7), (8, 9))


@pytest.mark.parametrize("origin", [(10_000.0, 20_000.0), (-30.0, -40.0), (0.25, 1e-12)])
def test_grid_of_squares_has_as_many_pixels_as_area(origin: tuple[float, float]) -> None:
    raster = rasterize(grid_mesh(6, 5, (4.0, 3.0), origin=origin, cells="mixed"))
    assert raster.pixel_counts.sum() == 6 * 5 * 12


def test_cell_between_pixel_centres_has_no_pixel() -> None:
    raster = rasterize(build_mesh(np.array([[1.2, 1.2], [1.8, 1.2], [1.5, 1.9]]),
                                       {T3: np.array([[0, 1, 2]])}))
    assert raster.pixel_counts.tolist() == [0]
    with pytest.raises(ValueError, match="no pixel centre"):
        _ = raster.window


@settings(max_examples=30)
@given(mesh=grid_meshes(), seed=SEEDS)
def test_counts_in_a_window_of_an_image(mesh: Mesh, seed: int) -> None:
    image = np.random.default_rng(seed).integers(0, 2, (15, 23)).astype(np.uint8)
    x0, y0 = -4, 3
    raster = rasterize(mesh)
    expected = [sum(int(image[y - y0, x - x0]) for x, y in pixels if x0 <= x < x0 + 23 and y0 <= y < y0 + 15)
                for pixels in pixels_of(raster)]
    assert raster.sum_by_cell(image, Window.between([x0, y0], np.add([x0, y0], image.shape[::-1]))).tolist() == expected


def test_coverage_is_clipped_to_the_image() -> None:
    raster = rasterize(grid_mesh(2, 2, (10.0, 10.0), origin=(-5.0, -5.0)))
    expected = np.zeros((8, 20), dtype=np.uint8)
    expected[:, :15] = 1
    np.testing.assert_array_equal(draw_all(raster, 20, 8), expected)


@settings(max_examples=50)
@given(mesh=ANY_MESH, seed=SEEDS)
def test_cells_are_drawn_and_summed_by_their_pixels(mesh: Mesh, seed: int) -> None:
    random = np.random.default_rng(seed)
    raster = rasterize(mesh)
    pixels = pixels_of(raster)
    if not any(pixels):
        return
    window = raster.window.grow(int(random.integers(0, 3)))
    cells = np.flatnonzero(random.random(mesh.n_cells) < 0.4)
    expected = np.zeros((window.height, window.width), dtype=np.uint8)
    for cell in cells:
        for x, y in pixels[cell]:
            expected[y - window.y0, x - window.x0] = 1
    np.testing.assert_array_equal(raster.draw_cells(cells, window), expected)
    image = random.uniform(-100, 100, expected.shape).astype(np.float32)
    sums = [sum(float(image[y - window.y0, x - window.x0]) for x, y in of_cell) for of_cell in pixels]
    found = raster.sum_by_cell(image, window)
    assert found.dtype == np.float64
    # Differences of sums along rows and over cells, some 1e5 grey levels large.
    np.testing.assert_allclose(found, sums, atol=1e-8)
    inner = window.x0 + 2
    cut = [sum(float(image[y - window.y0, x - window.x0]) for x, y in of_cell if x >= inner) for of_cell in pixels]
    if window.width > 2:
        seen = Window((inner, window.y0), window.upper)
        np.testing.assert_allclose(raster.sum_by_cell(image[:, 2:], seen), cut, atol=1e-8)


def test_pixels_are_counted_once() -> None:
    raster = rasterize(build_mesh(np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 4.0]]), {T3: np.array([[0, 1, 2]])}))
    assert raster.pixel_counts is raster.pixel_counts
