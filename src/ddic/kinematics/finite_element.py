"""Finite element kinematics: cell unknowns to and from nodal ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.mesh.mesh import Mesh
from ddic.mesh.shapes import N_MONOMIALS, SHAPE_COEFFICIENTS, geometry_coefficients, padded_cells


@dataclass(frozen=True)
class FiniteElementKinematics:
    """Displacement u = sum_a N_a q_a on a mesh of T3 and Q4.

    geometry: (n_cells, 2, 4), coefficients of x on the monomials (1, xi, eta, xi eta), pixels.
    shapes: (n_kinds, 4 nodes, 4 monomials) of each kind of cell in the mesh; a T3's fourth row is zero.
    kinds: (n_cells,) int64, each cell's place in shapes.
    cell_dofs: (n_cells, 8), node-major; a T3 repeats its first node's.
    n_dofs: number of unknowns.
    """

    geometry: NDArray[np.float64]
    shapes: NDArray[np.float64]
    kinds: NDArray[np.int64]
    cell_dofs: NDArray[np.int64]
    n_dofs: int

    def monomial_coefficients(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Coefficients of u on the monomials, (n_cells, 2, 4), from nodal unknowns q (n_dofs,), pixels."""
        nodal = q[self.cell_dofs].reshape(-1, N_MONOMIALS, 2).transpose(0, 2, 1)
        return self._by_kind(nodal, self.shapes)

    def assemble_vector(self, moments: NDArray[np.float64]) -> NDArray[np.float64]:
        """Assemble cell moments (n_cells, 2, 4) on the monomials into a nodal vector (n_dofs,)."""
        nodal = self._by_kind(moments, self.shapes.transpose(0, 2, 1)).transpose(0, 2, 1)
        summed = np.bincount(self.cell_dofs.ravel(), weights=nodal.ravel(), minlength=self.n_dofs)
        return summed.astype(np.float64, copy=False)

    def _by_kind(self, values: NDArray[np.float64], matrices: NDArray[np.float64]) -> NDArray[np.float64]:
        """Cells' values (n_cells, 2, 4) times the matrix of each cell's kind (n_kinds, 4, 4)."""
        rows = values.reshape(-1, N_MONOMIALS)
        kinds = np.repeat(self.kinds, values.shape[1])
        product = rows @ matrices[0]
        for kind in range(1, len(matrices)):
            of_kind = kinds == kind
            product[of_kind] = rows[of_kind] @ matrices[kind]
        return np.asarray(product.reshape(values.shape))

    def assemble_matrix(self, cells: NDArray[np.float64]) -> sparse.csr_matrix:
        """Assemble cell matrices (n_cells, 8, 8) into a sparse matrix (n_dofs, n_dofs)."""
        rows = np.repeat(self.cell_dofs, self.cell_dofs.shape[1], axis=1).ravel()
        columns = np.tile(self.cell_dofs, self.cell_dofs.shape[1]).ravel()
        shape = (self.n_dofs, self.n_dofs)
        return sparse.coo_matrix((cells.ravel(), (rows, columns)), shape=shape).tocsr()


def finite_element_kinematics(mesh: Mesh) -> FiniteElementKinematics:
    """Build the kinematics of a 2-D mesh."""
    nodes = padded_cells(mesh)
    cell_dofs = (nodes[:, :, None] * mesh.dim + np.arange(mesh.dim)).reshape(mesh.n_cells, -1)
    types, kinds = np.unique(mesh.types, return_inverse=True)
    shapes = np.stack([SHAPE_COEFFICIENTS[int(cell_type)] for cell_type in types])
    return FiniteElementKinematics(geometry_coefficients(mesh), shapes, kinds.astype(np.int64), cell_dofs, mesh.n_dofs)
