"""Plasticity in plane stress: stresses stay on the yield surface, forces have the tangent of the truth's solver."""

from __future__ import annotations

import numpy as np
import pytest

from accept.support.plastic_neck import assemble_tangent
from ddic.functionals.plasticity import PlasticCells, PlasticLaw, PlasticState
from ddic.functionals.regularization import Material, assemble_stiffness
from ddic.mesh.structured import build_structured_mesh

LAW = PlasticLaw(0.3, 0.002, 0.05)


def _equivalent_stress(stress: np.ndarray) -> np.ndarray:
    x, y, xy = stress.T
    return np.sqrt(x**2 + y**2 - x * y + 3.0 * xy**2)


def test_stresses_lie_on_the_hardened_yield_surface_or_within() -> None:
    random = np.random.default_rng(0)
    before = PlasticState(random.normal(0, 0.001, (2000, 3)), np.abs(random.normal(0, 0.002, 2000)))
    strain = random.normal(0, 0.004, (2000, 3))
    stress, now = LAW.compute_stress(strain, before)
    flows = now.amount > before.amount
    assert 0.5 < flows.mean() < 1.0
    reached = _equivalent_stress(stress) / (LAW.yield_strain + LAW.hardening_ratio * now.amount)
    # Newton's iteration ends at rounding.
    np.testing.assert_allclose(reached[flows], 1.0, rtol=1e-12)
    assert (reached[~flows] <= 1.0).all()
    elastic = np.array([[1.0, 0.3, 0.0], [0.3, 1.0, 0.0], [0.0, 0.0, 0.35]]) / (1.0 - 0.3**2)
    np.testing.assert_allclose(stress, (strain - now.strain) @ elastic.T, atol=1e-15)


def test_tension_follows_the_hardening_line() -> None:
    """In tension alone sigma = sigma_y + H alpha, alpha = e_xx - sigma / E, and the plastic strain keeps the volume."""
    axial = 0.01
    stress, state = np.zeros((1, 3)), PlasticState.none(1)
    # The transverse strain that leaves no transverse stress: elastic, and half of the plastic strain.
    sigma = (LAW.yield_strain + LAW.hardening_ratio * axial) / (1.0 + LAW.hardening_ratio)
    plastic = axial - sigma
    stress, state = LAW.compute_stress(np.array([[axial, -0.3 * sigma - 0.5 * plastic, 0.0]]), state)
    np.testing.assert_allclose(stress, [[sigma, 0.0, 0.0]], atol=1e-15)
    np.testing.assert_allclose(state.amount, plastic, rtol=1e-12)


@pytest.mark.parametrize("cell", ["Q4", "T3"])
def test_forces_have_the_tangent_of_newtons_method(cell: str) -> None:
    mesh = build_structured_mesh((0.0, 0.0, 64.0, 64.0), 8.0, cell=cell, circles=[((32.0, 32.0), 14.0)])
    cells = PlasticCells(mesh, LAW, np.linspace(0.5, 1.5, mesh.n_cells))
    none, random = PlasticState.none(cells.n_points), np.random.default_rng(0)
    q, v = random.normal(0, 0.02, (2, mesh.n_dofs))
    assert (cells.compute_forces(q, none)[1].amount > 0).mean() > 0.5
    step = 1e-6
    difference = (cells.compute_forces(q + step * v, none)[0] - cells.compute_forces(q - step * v, none)[0]) / 2 / step
    derivative = assemble_tangent(cells, q, none) @ v
    # Central differences, and a few points that come to flow between them.
    np.testing.assert_allclose(difference, derivative, atol=1e-6 * np.abs(derivative).max())


def test_small_displacements_are_elastic() -> None:
    mesh = build_structured_mesh((0.0, 0.0, 64.0, 48.0), 8.0)
    cells = PlasticCells(mesh, LAW, np.ones(mesh.n_cells))
    q = np.random.default_rng(1).normal(0, 1e-4, mesh.n_dofs)
    elastic = assemble_stiffness(mesh, Material(0.3, "stress")) @ q
    np.testing.assert_allclose(cells.compute_forces(q, PlasticState.none(cells.n_points))[0], elastic, atol=1e-17)
