"""Voxels of cells in space: each belongs to one, wherever the nodes are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ddic.images.window import Window
from ddic.mesh.grid import GridLines
from ddic.mesh.raster import rasterize
from support.random_meshes import SEEDS, box_mesh


@settings(max_examples=30)
@given(seed=SEEDS, cells=st.sampled_from(["Hex8", "Tet4", "both"]))
def test_cells_leave_no_voxel_between_them_and_share_none(seed: int, cells: str) -> None:
    mesh = box_mesh(seed, cells, (3, 2, 3))
    raster = rasterize(replace(mesh, nodes=mesh.nodes + 20.0))
    extent = Window.of_size(60, 50, 60)
    everywhere = np.arange(mesh.n_cells)
    assert raster.find_shared(extent).sum() == 0
    drawn = raster.draw_cells(everywhere, extent)
    assert drawn.sum() == raster.pixel_counts.sum()
    # Nodes at the border are moved by up to 1: what is farther inside is covered.
    first, last = mesh.nodes.min(axis=0) + 22.0, mesh.nodes.max(axis=0) + 18.0
    inside = tuple(slice(int(np.ceil(low)), int(high)) for low, high in zip(first[::-1], last[::-1], strict=True))
    assert drawn[inside].all()
    assert raster.window.locate_inside(raster.window) is not None


@pytest.mark.parametrize("cells", ["Hex8", "Tet4"])
def test_nodes_that_are_whole_numbers_but_for_rounding_leave_no_gap(cells: str) -> None:
    mesh = box_mesh(0, cells, (2, 2, 2), jitter=0.0)
    whole = np.round(mesh.nodes + 8.0)
    expected = rasterize(replace(mesh, nodes=whole))
    rng = np.random.default_rng(1)
    # As scales and offsets of mesh files leave them: a few units in the last place.
    off = replace(mesh, nodes=whole + 4e-15 * rng.integers(-1, 2, whole.shape) * np.maximum(whole, 1.0))
    found = rasterize(off)
    for name in ("first_rows", "n_rows", "starts", "stops"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_a_grid_counts_the_same_voxels_without_them() -> None:
    lines = tuple(np.array([4.0, 9.0 + off, 15.5, 21.0 - off]) for off in (4e-15, -4e-15, 1e-9))
    grid = GridLines(lines)
    counts = np.multiply.outer(np.multiply.outer(*grid.count_pixels()[::-1][:2]), grid.count_pixels()[0])
    np.testing.assert_array_equal(counts.ravel(), rasterize(grid.build_mesh()).pixel_counts)


def test_sums_of_a_slab_are_those_of_its_voxels() -> None:
    mesh = box_mesh(3, "Tet4", (2, 2, 2))
    raster = rasterize(replace(mesh, nodes=mesh.nodes + 20.0))
    extent = Window.of_size(50, 40, 50)
    values = np.random.default_rng(0).integers(0, 9, extent.shape)
    whole = raster.sum_by_cell(values, extent)
    slabs = sum(raster.sum_by_cell(values[extent.locate(slab)], slab) for slab in extent.split_rows(7))
    np.testing.assert_array_equal(slabs, whole)
