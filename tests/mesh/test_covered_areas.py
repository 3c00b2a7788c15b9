"""Areas of what cells cover."""

from __future__ import annotations

import numpy as np

from ddic.mesh.cut_mesh import cut_mesh
from ddic.mesh.quality import measure_areas, measure_covered_areas
from ddic.mesh.structured import build_structured_mesh

# Squares of 10 px, and a line that cuts a corner of 8 x 8 px and cells beside it.
MESH = build_structured_mesh((0, 0, 40, 30), 10)
LINE = np.array([[-2.0, 10.0], [10.0, -2.0]])
ROUNDING = 1e-12


def test_whole_cells_cover_their_areas() -> None:
    areas, shares = measure_covered_areas(MESH)
    np.testing.assert_allclose(areas, measure_areas(MESH), rtol=ROUNDING)
    np.testing.assert_array_equal(shares, 1.0)


def test_parts_of_a_cell_cover_it_together() -> None:
    cut = cut_mesh(MESH, [LINE]).mesh
    areas, shares = measure_covered_areas(cut)
    assert cut.n_cells == MESH.n_cells + 1
    np.testing.assert_allclose(areas.sum(), 1200.0, rtol=ROUNDING)
    # The corner is half of a square of 8 px.
    np.testing.assert_allclose(np.sort(shares)[:2], [0.32, 0.68], rtol=ROUNDING)
    np.testing.assert_allclose(areas, 100.0 * shares, rtol=ROUNDING)
