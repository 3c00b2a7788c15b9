"""Interpolation in the cells: nodal displacements to each cell's coefficients, and cells' sums back to the nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.mesh.mesh import Mesh
from ddic.mesh.monomials import N_MONOMIALS
from ddic.mesh.shapes import compute_geometry, pad_cells, pad_shapes


@dataclass(frozen=True)
class CellInterpolation:
    """Displacement u = sum_a N_a q_a in every cell of a mesh, written on the monomials (1, xi, eta, xi eta).

    Attributes
    ----------
    geometry : (n_cells, dim, 4 monomials) array
        Coefficients of x, pixels.
    shapes : (n_kinds, 4 nodes, 4 monomials) array
        Shape coefficients of each cell type in the mesh; rows of nodes that a type does not have are zero.
    kinds : (n_cells,) int64 array
        Each cell's place in ``shapes``.
    cell_dofs : (n_cells, 4 dim) int64 array
        Displacement components of each cell's nodes, node-major; a cell of fewer nodes repeats its first node's.
    n_dofs : int
        Number of the mesh's displacement components.
    """

    geometry: NDArray[np.float64]
    shapes: NDArray[np.float64]
    kinds: NDArray[np.int64]
    cell_dofs: NDArray[np.int64]
    n_dofs: int

    @property
    def dim(self) -> int:
        """Number of space dimensions."""
        return int(self.geometry.shape[1])

    def monomial_coefficients(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Write a displacement on the monomials, cell by cell.

        Parameters
        ----------
        q : (n_dofs,) array
            Nodal displacement, pixels.

        Returns
        -------
        (n_cells, dim, 4 monomials) array
            Coefficients of u, pixels.
        """
        nodal = q[self.cell_dofs].reshape(-1, N_MONOMIALS, self.dim).transpose(0, 2, 1)
        return self._multiply_by_kind(nodal, self.shapes)

    def assemble_vector(self, moments: NDArray[np.float64]) -> NDArray[np.float64]:
        """Assemble the cells' sums over pixels of some vector times the monomials.

        Parameters
        ----------
        moments : (n_cells, dim, 4 monomials) array
            Sums of each cell.

        Returns
        -------
        (n_dofs,) array
            Sums over all pixels of the vector times N_a.
        """
        nodal = self._multiply_by_kind(moments, self.shapes.transpose(0, 2, 1)).transpose(0, 2, 1)
        summed = np.bincount(self.cell_dofs.ravel(), weights=nodal.ravel(), minlength=self.n_dofs)
        return summed.astype(np.float64, copy=False)

    def assemble_matrix(self, cells: NDArray[np.float64]) -> sparse.csr_matrix:
        """Assemble cell matrices into one of the whole mesh.

        Parameters
        ----------
        cells : (n_cells, 4 dim, 4 dim) array
            Matrices between the cells' displacement components, zero for nodes that a cell does not have.

        Returns
        -------
        (n_dofs, n_dofs) csr_matrix
            Their sum.
        """
        n_cell_dofs = self.cell_dofs.shape[1]
        rows = np.repeat(self.cell_dofs, n_cell_dofs, axis=1).ravel()
        columns = np.tile(self.cell_dofs, n_cell_dofs).ravel()
        shape = (self.n_dofs, self.n_dofs)
        return sparse.coo_matrix((cells.ravel(), (rows, columns)), shape=shape).tocsr()

    def _multiply_by_kind(self, values: NDArray[np.float64], matrices: NDArray[np.float64]) -> NDArray[np.float64]:
        """Cells' values (n_cells, dim, 4) times the matrix of each cell's kind (n_kinds, 4, 4)."""
        rows = values.reshape(-1, N_MONOMIALS)
        kinds = np.repeat(self.kinds, self.dim)
        # All cells are mostly of one kind, so one large product and a correction beat a gather and scatter of each.
        product = rows @ matrices[0]
        for kind in range(1, len(matrices)):
            of_kind = kinds == kind
            product[of_kind] = rows[of_kind] @ matrices[kind]
        return np.asarray(product.reshape(values.shape))


def interpolate_cells(mesh: Mesh) -> CellInterpolation:
    """Prepare the interpolation in the cells of a mesh.

    Parameters
    ----------
    mesh : Mesh
        Any.

    Returns
    -------
    CellInterpolation
        Of its cells.
    """
    cell_dofs = (pad_cells(mesh)[:, :, None] * mesh.dim + np.arange(mesh.dim)).reshape(mesh.n_cells, -1)
    shapes = np.stack([pad_shapes(block.type) for block in mesh.cell_blocks])
    kinds = np.empty(mesh.n_cells, dtype=np.int64)
    for place, block in enumerate(mesh.cell_blocks):
        kinds[block.cells] = place
    return CellInterpolation(compute_geometry(mesh), shapes, kinds, cell_dofs, mesh.n_dofs)
