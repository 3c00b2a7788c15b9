"""Nodal unknowns to coefficients on the monomials, and back."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings

from ddic.kinematics.cell_interpolation import interpolate_cells
from ddic.mesh.cell_type import Q4, evaluate_monomials
from ddic.mesh.mesh import Mesh, pad_cells
from support.random_meshes import SEEDS, grid_mesh, grid_meshes


@settings(max_examples=40)
@given(mesh=grid_meshes(), seed=SEEDS)
def test_displacement_at_corners_is_the_nodes(mesh: Mesh, seed: int) -> None:
    q = np.random.default_rng(seed).normal(size=mesh.n_dofs)
    u = interpolate_cells(mesh).monomial_coefficients(q)
    for block in mesh.cell_blocks:
        found = np.einsum("ecm,am->eac", u[block.cells], evaluate_monomials(block.type.nodes))
        # A few additions of numbers of order one.
        np.testing.assert_allclose(found, q.reshape(-1, mesh.dim)[block.nodes], atol=1e-14)


@settings(max_examples=40)
@given(mesh=grid_meshes(), seed=SEEDS)
def test_assembly_is_the_transpose_of_interpolation(mesh: Mesh, seed: int) -> None:
    rng = np.random.default_rng(seed)
    interpolation = interpolate_cells(mesh)
    q, moments = rng.normal(size=mesh.n_dofs), rng.normal(size=(mesh.n_cells, 2, 4))
    left = (interpolation.monomial_coefficients(q) * moments).sum()
    # Rounding of sums of at most some hundred terms of order one.
    np.testing.assert_allclose(interpolation.assemble_vector(moments) @ q, left, atol=1e-12)


@settings(max_examples=20)
@given(mesh=grid_meshes(most=3), seed=SEEDS)
def test_matrices_are_assembled_by_their_cells_dofs(mesh: Mesh, seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells = rng.normal(size=(mesh.n_cells, 8, 8))
    cells[mesh.types != Q4.vtk, 6:] = 0
    cells[mesh.types != Q4.vtk, :, 6:] = 0
    expected = np.zeros((mesh.n_dofs, mesh.n_dofs))
    for e in range(mesh.n_cells):
        nodes = mesh.connectivity[mesh.offsets[e]: mesh.offsets[e + 1]]
        dofs = [2 * int(a) + c for a in nodes for c in range(2)]
        expected[np.ix_(dofs, dofs)] += cells[e, : len(dofs), : len(dofs)]
    found = interpolate_cells(mesh).assemble_matrix(cells)
    assert found.shape == expected.shape
    np.testing.assert_allclose(found.toarray(), expected, atol=1e-14)


@settings(max_examples=20)
@given(mesh=grid_meshes(most=3), seed=SEEDS)
def test_cells_about_a_node_alone_make_its_rows_to_the_last_bit(mesh: Mesh, seed: int) -> None:
    rng = np.random.default_rng(seed)
    interpolation, cells = interpolate_cells(mesh), rng.normal(size=(mesh.n_cells, 8, 8))
    node = int(mesh.connectivity[0])
    about = np.flatnonzero((pad_cells(mesh) == node).any(axis=1))
    whole, part = interpolation.assemble_matrix(cells), interpolation.assemble_matrix(cells[about], about)
    assert whole.has_canonical_format
    np.testing.assert_array_equal(part[2 * node:2 * node + 2].toarray(), whole[2 * node:2 * node + 2].toarray())
    assert interpolation.assemble_matrix(cells[:0], about[:0]).nnz == 0


def test_sizes() -> None:
    mesh = grid_mesh(3, 2, (4.0, 4.0), cells="mixed", seed=2)
    interpolation = interpolate_cells(mesh)
    assert interpolation.n_dofs == 2 * 12
    assert interpolation.cell_dofs.shape == (mesh.n_cells, 8)
    # Also where the last nodes belong to no cell.
    bare = Mesh(np.vstack([mesh.nodes, [[99.0, 99.0]]]), mesh.connectivity, mesh.offsets, mesh.types)
    assert interpolate_cells(bare).assemble_vector(np.ones((mesh.n_cells, 2, 4))).shape == (26,)


def test_no_cells_have_no_forces_at_their_corners() -> None:
    interpolation = interpolate_cells(grid_mesh(2, 2, (5.0, 5.0)))
    taken = interpolation.take_to_corners(np.zeros(0, dtype=np.int64), np.zeros((0, 2, 4)))
    assert taken.shape == (0, 8)
