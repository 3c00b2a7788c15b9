"""Nodal unknowns to coefficients on the monomials, and back."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings

from ddic.kinematics.finite_element import finite_element_kinematics
from ddic.mesh.mesh import VTK_QUAD, Mesh
from ddic.mesh.shapes import monomials
from support.random_meshes import SEEDS, grid_mesh, grid_meshes


@settings(max_examples=40)
@given(mesh=grid_meshes(), seed=SEEDS)
def test_displacement_at_corners_is_the_nodes(mesh: Mesh, seed: int) -> None:
    q = np.random.default_rng(seed).normal(size=mesh.n_dofs)
    u = finite_element_kinematics(mesh).monomial_coefficients(q)
    corners = {4: np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]]), 3: np.array([[0.0, 0], [1, 0], [0, 1]])}
    for e in range(mesh.n_cells):
        nodes = mesh.connectivity[mesh.offsets[e]: mesh.offsets[e + 1]]
        # A few additions of numbers of order one.
        np.testing.assert_allclose(monomials(corners[len(nodes)]) @ u[e].T, q.reshape(-1, 2)[nodes], atol=1e-14)


@settings(max_examples=40)
@given(mesh=grid_meshes(), seed=SEEDS)
def test_assembly_is_the_transpose_of_interpolation(mesh: Mesh, seed: int) -> None:
    rng = np.random.default_rng(seed)
    kinematics = finite_element_kinematics(mesh)
    q, moments = rng.normal(size=mesh.n_dofs), rng.normal(size=(mesh.n_cells, 2, 4))
    left = (kinematics.monomial_coefficients(q) * moments).sum()
    # Rounding of sums of at most some hundred terms of order one.
    np.testing.assert_allclose(kinematics.assemble_vector(moments) @ q, left, atol=1e-12)


@settings(max_examples=20)
@given(mesh=grid_meshes(most=3), seed=SEEDS)
def test_matrices_are_assembled_by_their_cells_dofs(mesh: Mesh, seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells = rng.normal(size=(mesh.n_cells, 8, 8))
    cells[mesh.types != VTK_QUAD, 6:] = 0
    cells[mesh.types != VTK_QUAD, :, 6:] = 0
    expected = np.zeros((mesh.n_dofs, mesh.n_dofs))
    for e in range(mesh.n_cells):
        nodes = mesh.connectivity[mesh.offsets[e]: mesh.offsets[e + 1]]
        dofs = [2 * int(a) + c for a in nodes for c in range(2)]
        expected[np.ix_(dofs, dofs)] += cells[e, : len(dofs), : len(dofs)]
    found = finite_element_kinematics(mesh).assemble_matrix(cells)
    assert found.shape == expected.shape
    np.testing.assert_allclose(found.toarray(), expected, atol=1e-14)


def test_sizes() -> None:
    mesh = grid_mesh(3, 2, (4.0, 4.0), cells="mixed", seed=2)
    kinematics = finite_element_kinematics(mesh)
    assert kinematics.n_dofs == 2 * 12
    assert kinematics.cell_dofs.shape == (mesh.n_cells, 8)
    # Also where the last nodes belong to no cell.
    bare = Mesh(np.vstack([mesh.nodes, [[99.0, 99.0]]]), mesh.connectivity, mesh.offsets, mesh.types)
    assert finite_element_kinematics(bare).assemble_vector(np.ones((mesh.n_cells, 2, 4))).shape == (26,)
