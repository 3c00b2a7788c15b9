"""Forces out of equilibrium of fields whose stress is known."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

from ddic.functionals.regularization import Material
from ddic.functionals.texture import measure_gap
from ddic.mesh.structured import build_structured_mesh

MATERIAL = Material(0.3)


@pytest.mark.parametrize("size", [5.0, 10.0])
@pytest.mark.parametrize(("cell", "within"), [("Q4", 1e-9), ("T3", 0.25)])
def test_it_is_the_divergence_of_the_stress_whatever_the_elements(size: float, cell: Literal["Q4", "T3"],
                                                                  within: float) -> None:
    mesh = build_structured_mesh((0, 0, 60, 80), size, cell)
    x, _ = mesh.nodes.T
    u = np.column_stack([1e-3 * x**2 / 2, np.zeros_like(x)])
    # div s = E / (1 - nu^2) d2u/dx2 along x, nothing along y; regular Q4 have exact second
    # differences; nodes of four triangles beside those of eight have not, whatever the size.
    expected = 1e-3 / (1 - 0.3**2) / np.sqrt(2)
    assert measure_gap(mesh, u, MATERIAL) == pytest.approx(expected, rel=within)


def test_linear_fields_are_in_equilibrium_and_missing_nodes_do_not_count() -> None:
    mesh = build_structured_mesh((0, 0, 60, 60), 10.0)
    u = mesh.nodes @ np.array([[0.01, 0.02], [-0.03, 0.005]])
    assert measure_gap(mesh, u, MATERIAL) < 1e-15
    u[24] = np.nan
    assert measure_gap(mesh, u, MATERIAL) < 1e-15
    assert np.isnan(measure_gap(mesh, np.full_like(u, np.nan), MATERIAL))
