"""Interpolation in the cells: nodal displacements to each cell's coefficients, and cells' sums back to the nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numba
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
        coefficients = np.empty((len(self.kinds), self.dim, N_MONOMIALS))
        _expand(np.ascontiguousarray(q, dtype=np.float64), self.cell_dofs, self.kinds, self.shapes, coefficients)
        return coefficients

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
        summed = np.zeros(self.n_dofs)
        _add_up(np.ascontiguousarray(moments), self.cell_dofs, self.kinds, self.shapes, summed)
        return summed

    def assemble_matrix(self, cells: NDArray[np.float64],
                        numbers: NDArray[np.int64] | None = None) -> sparse.csr_matrix:
        """Assemble cell matrices into one of the whole mesh.

        Parameters
        ----------
        cells : (n, 4 dim, 4 dim) array
            Matrices between the cells' displacement components, zero for nodes that a cell does not have.
        numbers : (n,) int64 array, optional
            Of these cells; by default all of the mesh's.

        Returns
        -------
        (n_dofs, n_dofs) csr_matrix
            Their sum.
        """
        n_cell_dofs = self.cell_dofs.shape[1]
        # As scipy keeps them: it would make copies of others, beside the largest arrays of an assembly.
        of_cells = self.cell_dofs if numbers is None else self.cell_dofs[numbers]
        cell_dofs = of_cells.astype(sparse.get_index_dtype(maxval=self.n_dofs))
        rows = np.repeat(cell_dofs, n_cell_dofs, axis=1).ravel()
        columns = np.tile(cell_dofs, n_cell_dofs).ravel()
        shape = (self.n_dofs, self.n_dofs)
        return sparse.coo_matrix((cells.ravel(), (rows, columns)), shape=shape).tocsr()


def number_cell_dofs(mesh: Mesh) -> NDArray[np.int64]:
    """Give the displacement components of the nodes of every cell.

    Parameters
    ----------
    mesh : Mesh
        Any.

    Returns
    -------
    (n_cells, 4 dim) int64 array
        Node-major; a cell of fewer nodes repeats its first node's.
    """
    return (pad_cells(mesh)[:, :, None] * mesh.dim + np.arange(mesh.dim)).reshape(mesh.n_cells, -1)


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
    shapes = np.stack([pad_shapes(block.type) for block in mesh.cell_blocks])
    kinds = np.empty(mesh.n_cells, dtype=np.int64)
    for place, block in enumerate(mesh.cell_blocks):
        kinds[block.cells] = place
    return CellInterpolation(compute_geometry(mesh), shapes, kinds, number_cell_dofs(mesh), mesh.n_dofs)


# Compiled, since products of many small matrices by numpy took a third of a pass over a subdomain of 33,000 px.


@numba.njit(cache=True, nogil=True)
def _expand(q, cell_dofs, kinds, shapes, coefficients):  # type: ignore[no-untyped-def]
    """Write sum_a q_a T_am of every cell and component into coefficients (n_cells, dim, 4)."""
    n_cells, dim, n_monomials = coefficients.shape
    for e in range(n_cells):
        of_kind = shapes[kinds[e]]
        for i in range(dim):
            for m in range(n_monomials):
                value = 0.0
                for a in range(of_kind.shape[0]):
                    value += q[cell_dofs[e, a * dim + i]] * of_kind[a, m]
                coefficients[e, i, m] = value


@numba.njit(cache=True, nogil=True)
def _add_up(moments, cell_dofs, kinds, shapes, summed):  # type: ignore[no-untyped-def]
    """Add sum_m T_am moments_m of every cell, node and component to summed (n_dofs,)."""
    n_cells, dim, n_monomials = moments.shape
    for e in range(n_cells):
        of_kind = shapes[kinds[e]]
        for a in range(of_kind.shape[0]):
            for i in range(dim):
                value = 0.0
                for m in range(n_monomials):
                    value += of_kind[a, m] * moments[e, i, m]
                summed[cell_dofs[e, a * dim + i]] += value
