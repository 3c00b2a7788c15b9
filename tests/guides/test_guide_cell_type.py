from __future__ import annotations

import numpy as np
import pytest

import ddic.mesh.mesh
from support.guides import run_guide


def test_cell_type(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (ddic.mesh.mesh, ddic.mesh.mesh):
        # Put back when the test ends: the guide replaces it.
        monkeypatch.setattr(module, "CELL_TYPES", module.CELL_TYPES)
    guide = run_guide("cell-type")
    n_dofs = guide["full"].n_dofs
    assert guide["rank_full"] == n_dofs - 3
    assert guide["rank_reduced"] == n_dofs - 6
    full, reduced = guide["forces"]
    assert np.abs(full - reduced).max() < 1e-12 * np.abs(full).max()
    rasters = guide["pixels"]
    assert rasters[0].pixel_counts.tolist() == rasters[1].pixel_counts.tolist()
    assert rasters[0].pixel_counts.min() > 0
