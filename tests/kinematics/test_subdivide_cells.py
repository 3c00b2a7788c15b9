"""Small cells in place of large ones: same area, same pixels."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.kinematics.tip_functions import subdivide_cells
from ddic.mesh.cell_type import Q4, T3
from ddic.mesh.mesh import build_mesh
from ddic.mesh.quality import measure_areas
from ddic.mesh.raster import rasterize
from ddic.mesh.structured import build_structured_mesh


@pytest.mark.parametrize("kind", ["Q4", "T3"])
def test_small_cells_cover_the_same_pixels(kind: str) -> None:
    # Sides run through pixel centres, where a pixel would count twice if rounding decided.
    mesh = build_structured_mesh((20, 20, 84, 68), 16, kind)
    cells = np.arange(3, mesh.n_cells)
    small, cell_of = subdivide_cells(mesh, cells, 2.0)
    counts = np.bincount(cell_of, weights=rasterize(small).pixel_counts, minlength=mesh.n_cells)
    np.testing.assert_array_equal(counts[3:], rasterize(mesh).pixel_counts[3:])
    areas = np.bincount(cell_of, weights=measure_areas(small), minlength=mesh.n_cells)
    np.testing.assert_allclose(areas[3:], measure_areas(mesh)[3:], rtol=1e-12)
    assert measure_areas(small).min() > 0


def test_sides_are_no_longer_than_asked_for() -> None:
    nodes = np.array([[0.0, 0.0], [13.0, 1.0], [12.0, 9.0], [-1.0, 8.0], [20.0, 20.0]])
    mesh = build_mesh(nodes, {Q4: np.array([[0, 1, 2, 3]]), T3: np.array([[1, 4, 2]])})
    small, cell_of = subdivide_cells(mesh, np.arange(2), 2.5)
    assert np.bincount(cell_of).tolist() == [36, 81]
    for block in small.cell_blocks:
        corners = small.nodes[small.cells[block.cells, :block.type.n_nodes]]
        sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        assert sides.max() < 2.5
