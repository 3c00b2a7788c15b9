"""Stiffness and strain of a cut mesh: each side is a body of its own."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.functionals.regularization import Material, assemble_stiffness
from ddic.kinematics.strain import compute_strain
from ddic.mesh.cut_mesh import cut_mesh
from ddic.mesh.structured import build_structured_mesh

LINE = np.array([[0.0, 50.3], [300.0, 140.2]])
NORMAL = np.array([-89.9, 300.0])


@pytest.mark.parametrize("kind", ["Q4", "T3"])
def test_continuous_displacement_has_the_energy_of_the_whole_mesh(kind: str) -> None:
    mesh = build_structured_mesh((20, 20, 180, 180), 16, kind)
    cut = cut_mesh(mesh, [LINE])
    u = np.random.default_rng(0).normal(size=(mesh.n_nodes, 2))
    expected = u.ravel() @ assemble_stiffness(mesh, Material()) @ u.ravel()
    u_cut = u[cut.node_of].ravel()
    # Sums of some thousand products in another order.
    assert u_cut @ assemble_stiffness(cut.mesh, Material()) @ u_cut == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("kind", ["Q4", "T3"])
def test_rigid_motions_of_both_sides_cost_nothing_and_no_others_do(kind: str) -> None:
    cut = cut_mesh(build_structured_mesh((20, 20, 180, 180), 32, kind), [LINE])
    stiffness = assemble_stiffness(cut.mesh, Material()).toarray()
    np.testing.assert_allclose(stiffness, stiffness.T, atol=1e-14)
    eigenvalues = np.linalg.eigvalsh(stiffness)
    assert np.abs(eigenvalues[:6]).max() < 1e-13
    # A sliver costs little; 1e-10 is far above rounding.
    assert eigenvalues[6] > 1e-10


@pytest.mark.parametrize("kind", ["Q4", "T3"])
def test_strain_is_that_of_each_side(kind: str) -> None:
    cut = cut_mesh(build_structured_mesh((20, 20, 180, 180), 16, kind), [LINE])
    above = (cut.mesh.centroids - LINE[0]) @ NORMAL > 0
    u = np.column_stack([0.01 * cut.mesh.nodes[:, 0], np.zeros(cut.mesh.n_nodes)])
    nodes_above = np.unique(cut.mesh.cells[above])
    nodes_above = nodes_above[nodes_above >= 0]
    u[nodes_above] = np.column_stack([np.full(len(nodes_above), 5.0), -0.02 * cut.mesh.nodes[nodes_above, 1]])
    strain = compute_strain(cut.mesh, u.ravel()).infinitesimal
    np.testing.assert_allclose(strain[above], np.broadcast_to([0.0, -0.02, 0.0], strain[above].shape), atol=1e-12)
    np.testing.assert_allclose(strain[~above], np.broadcast_to([0.01, 0.0, 0.0], strain[~above].shape), atol=1e-12)
