"""What is drawn over an image: edges of cells, fields in colour, hatching; each where it lies."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.mesh.interpolation import CellSearch
from ddic.mesh.structured import build_grid_lines, build_structured_mesh
from ddic.mesh.topology import find_boundary_facets
from ddic.page.image_pane import ScreenRaster
from ddic.page.layers import (
    DOT,
    SMALLEST_CELL,
    Overlay,
    draw_dots,
    draw_edges,
    draw_field,
    draw_hatching,
    find_cell_centres,
    find_nodes_in_sight,
)
from support.random_meshes import grid_mesh

PITCH = 0.25
RASTER = ScreenRaster(np.full((240, 320), 100, np.uint8), (-0.5, -0.5, 79.5, 59.5))
"""80 x 60 px of an image, four pixels of the screen along the side of one."""


def drawn_edges(element_size: float) -> NDArray[np.bool_]:
    """Where something was drawn, of a mesh from 10 to 58 px and from 10 to 42 px."""
    rgba = np.full((*RASTER.grey.shape, 4), 100, np.uint8)
    mesh = build_structured_mesh((10.0, 10.0, 58.0, 42.0), element_size)
    draw_edges(rgba, RASTER, mesh, find_boundary_facets(mesh)[:, :2], (255, 0, 0))
    return np.asarray((rgba[..., :3] != 100).any(axis=2))


def test_edges_lie_where_the_cells_meet() -> None:
    """Columns of nodes 8 px apart: a smooth line takes up to three pixels of the screen about each, to half a one."""
    row = drawn_edges(8.0)[round((30.0 + 0.5) / PITCH)]
    runs = np.split(np.flatnonzero(row), np.flatnonzero(np.diff(np.flatnonzero(row)) > 1) + 1)
    expected = (np.arange(10.0, 59.0, 8.0) + 0.5) / PITCH - 0.5
    np.testing.assert_allclose([run.mean() for run in runs], expected, atol=0.5)
    assert max(map(len, runs)) <= 3


def test_of_cells_too_small_to_see_the_outline_is_left() -> None:
    """Cells of one pixel are four of the screen, less than SMALLEST_CELL: inside nothing is drawn."""
    assert 1.0 / PITCH < SMALLEST_CELL < 2.0 / PITCH
    low, high = (10.0 + 1.5) / PITCH, (42.0 - 0.5) / PITCH
    inside = np.s_[int(low):int(high), int(low):int((58.0 - 0.5) / PITCH)]
    assert drawn_edges(2.0)[inside].mean() > 0.1
    outline = drawn_edges(1.0)
    assert not outline[inside].any()
    rows, columns = np.nonzero(outline)
    corners = [rows.min(), columns.min(), rows.max(), columns.max()]
    assert np.abs(np.array(corners) - (np.array([10.0, 10.0, 42.0, 58.0]) + 0.5) / PITCH).max() <= 1.5


GRID = build_grid_lines((10.0, 10.0, 58.0, 42.0), 4.0)
SIDE_BY_SIDE = GRID.build_mesh()
WINDOW = ScreenRaster(np.full((96, 120), 100, np.uint8), (20.0, 3.0, 50.0, 27.0))
"""A part of that grid and of what lies above it."""


@pytest.mark.parametrize("raster", [RASTER, WINDOW])
def test_a_grid_is_drawn_as_its_mesh(raster: ScreenRaster) -> None:
    """Lines of the grid lie where edges of its cells do, but where they are drawn twice or end in the last pixel."""
    drawn = []
    for mesh in (GRID, SIDE_BY_SIDE):
        rgba = np.full((*raster.grey.shape, 4), 100, np.uint8)
        draw_edges(rgba, raster, mesh, find_boundary_facets(SIDE_BY_SIDE)[:, :2], (255, 0, 0))
        drawn.append((rgba[..., :3] != 100).any(axis=2))
    assert drawn[0].sum() > 1000
    assert (drawn[0] != drawn[1]).mean() < 0.01


def test_of_a_fine_grid_the_outline_is_left() -> None:
    rgba = np.full((*RASTER.grey.shape, 4), 100, np.uint8)
    draw_edges(rgba, RASTER, build_grid_lines((10.0, 10.0, 58.0, 42.0), 1.0), np.zeros((0, 2), np.int64), (255, 0, 0))
    rows, columns = np.nonzero((rgba[..., :3] != 100).any(axis=2))
    middle = (rows > 60) & (rows < 150) & (columns > 60) & (columns < 220)
    assert len(rows) > 500
    assert not middle.any()


@pytest.mark.parametrize("raster", [RASTER, WINDOW])
def test_cells_of_a_grid_are_found_as_those_of_its_mesh(raster: ScreenRaster) -> None:
    centres = find_cell_centres(GRID, raster)
    known = np.isfinite(centres).all(axis=1)
    assert 0 < known.sum() < len(known)
    # Means of two and of four coordinates of some ten pixels.
    expected = find_cell_centres(SIDE_BY_SIDE, raster)
    np.testing.assert_array_equal(known, np.isfinite(expected).all(axis=1))
    np.testing.assert_allclose(centres[known], expected[known], atol=1e-12)


@pytest.mark.parametrize("raster", [RASTER, WINDOW])
def test_nodes_of_a_grid_are_those_of_its_mesh_in_sight(raster: ScreenRaster) -> None:
    nodes = SIDE_BY_SIDE.nodes
    in_sight = ((nodes >= raster.box[:2]) & (nodes <= raster.box[2:])).all(axis=1)
    np.testing.assert_array_equal(find_nodes_in_sight(GRID, raster), nodes[in_sight])


def test_of_nodes_finer_than_the_screen_some_are_left() -> None:
    """A grid of four million nodes, of which the screen has room for one in each dot."""
    nodes = find_nodes_in_sight(build_grid_lines((0.0, 0.0, 79.0, 59.0), 0.04), RASTER)
    assert len(nodes) <= np.prod(RASTER.grey.shape)
    np.testing.assert_allclose(np.ptp(nodes, axis=0), (79.0, 59.0), atol=4.0 * PITCH)


def test_dots_lie_on_their_points() -> None:
    rgba = np.full((*RASTER.grey.shape, 4), 100, np.uint8)
    draw_dots(rgba, RASTER, np.array([(20.0, 10.0), (500.0, 10.0), (-3.0, -3.0)]), (255, 0, 0))
    rows, columns = np.nonzero(rgba[..., 0] == 255)
    assert len(rows) == DOT**2
    assert (columns.mean(), rows.mean()) == pytest.approx(tuple((np.array([20.0, 10.0]) + 0.5) / PITCH), abs=1.0)


def test_values_lie_where_the_mesh_is() -> None:
    """Linear between nodes of any cells, those of cells as they are, nan outside."""
    mesh = grid_mesh(6, 4, (8.0, 8.0), origin=(10.0, 10.0), cells="mixed", jitter=0.2)
    overlay = Overlay.find(CellSearch(mesh), RASTER)
    places = RASTER.centres
    linear = overlay.interpolate(2.0 + 0.3 * mesh.nodes[:, 0] - 0.1 * mesh.nodes[:, 1], by_cell=False)
    known = np.isfinite(linear)
    np.testing.assert_allclose(linear[known], (2.0 + places @ [0.3, -0.1])[known], atol=1e-12)
    numbers = overlay.interpolate(np.arange(mesh.n_cells, dtype=float), by_cell=True)
    np.testing.assert_array_equal(np.isfinite(numbers), known)
    assert set(numbers[known].tolist()) == set(range(mesh.n_cells))
    # Its area, but for the pixels that its edge cuts: half of some five hundred.
    assert abs(known.sum() * PITCH**2 - mesh_area(mesh.nodes, 6, 4)) < 500 * PITCH**2
    np.testing.assert_array_equal(overlay.find_pixels(np.arange(mesh.n_cells) == 3), numbers == 3.0)


def mesh_area(nodes: NDArray[np.float64], columns: int, rows: int) -> float:
    """By the outline of a grid of nodes."""
    grid = nodes.reshape(rows + 1, columns + 1, 2)
    x, y = np.concatenate([grid[0], grid[1:, -1], grid[-1, -2::-1], grid[-2:0:-1, 0]]).T
    return float(0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def test_layers_leave_what_is_not_known() -> None:
    rgba = np.full((2, 3, 4), 100, np.uint8)
    draw_field(rgba, np.array([0.0, np.nan, 1.0, 5.0, -5.0, np.nan]), (0.0, 1.0), "gray")
    assert rgba[0, :, 0].tolist() == [30, 100, 30 + round(0.7 * 255)]
    # Beyond the limits: the colours at the ends.
    assert rgba[1, :, 0].tolist() == [30 + round(0.7 * 255), 30, 100]
    assert (rgba[..., 3] == 100).all()
    draw_hatching(rgba, np.array([False, True, False, False, False, False]), (9, 8, 7))
    assert rgba[0, 1, :3].tolist() == [9, 8, 7]
    assert rgba[0, 0, 0] == 30
