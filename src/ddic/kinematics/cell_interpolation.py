"""Interpolation in the cells: nodal displacements to each cell's coefficients, and cells' sums back to the nodes."""

from dataclasses import dataclass

import numba
import numpy as np
from scipy import sparse

from ddic.arrays import Array, IntArray
from ddic.mesh.mesh import Mesh, compute_geometry, pad_cells, pad_shapes


@dataclass(frozen=True)
class CellInterpolation:
    """Displacement u = sum_a N_a q_a in every cell of a mesh, written on the monomials.

    Attributes
    ----------
    geometry : (n_cells, dim, n_monomials) array
        Coefficients of x, pixels.
    shapes : (n_kinds, n_monomials, n_monomials) array
        Shape coefficients of each cell type in the mesh; rows of nodes that a type does not have are zero.
    kinds : (n_cells,) int64 array
        Each cell's place in ``shapes``.
    cell_dofs : (n_cells, n_monomials dim) int64 array
        Displacement components of each cell's nodes, node-major; a cell of fewer nodes repeats its first node's.
    n_dofs : int
        Number of the mesh's displacement components.
    """

    geometry: Array
    shapes: Array
    kinds: IntArray
    cell_dofs: IntArray
    n_dofs: int

    @property
    def dim(self) -> int:
        """Number of space dimensions."""
        return int(self.geometry.shape[1])

    def monomial_coefficients(self, q: Array) -> Array:
        """Write a nodal displacement on the monomials, cell by cell, (n_cells, dim, n_monomials), pixels."""
        coefficients = np.empty((len(self.kinds), self.dim, self.shapes.shape[2]))
        _expand(np.ascontiguousarray(q, dtype=np.float64), self.cell_dofs, self.kinds, self.shapes, coefficients)
        return coefficients

    def assemble_vector(self, moments: Array) -> Array:
        """Assemble the cells' sums over pixels of some vector times the monomials, (n_cells, dim, n_monomials).

        Gives the sums over all pixels of the vector times N_a, (n_dofs,).
        """
        summed = np.zeros(self.n_dofs)
        _add_up(np.ascontiguousarray(moments), self.cell_dofs, self.kinds, self.shapes, summed)
        return summed

    def take_to_corners(self, cells: IntArray, moments: Array) -> Array:
        """Take sums of some cells over pixels, of a vector times the monomials, to the corners of each.

        From (n, dim, n_monomials) to sums over the cell's pixels of the vector times N_a, (n, n_monomials dim),
        node-major; zero for nodes that a cell does not have.
        """
        of_corners = np.einsum("eam,eim->eai", self.shapes[self.kinds[cells]], moments)
        n, n_corners, dim = of_corners.shape
        # Said in full: n may be 0, where a frame shows none of a subdomain's cells.
        return np.asarray(of_corners.reshape(n, n_corners * dim))

    def assemble_matrix(self, cells: Array, numbers: IntArray | None = None) -> sparse.csr_matrix:
        """Assemble cell matrices, (n, n_monomials dim, n_monomials dim), into one of the whole mesh, (n_dofs, n_dofs).

        They are zero for nodes that a cell does not have; ``numbers`` are those of the cells, by default all of the
        mesh's.
        """
        of_cells = self.cell_dofs if numbers is None else self.cell_dofs[numbers]
        corners = np.ascontiguousarray(of_cells[:, ::self.dim] // self.dim)
        # As scipy keeps them: it would make copies of others.
        numbers_like = np.empty(0, sparse.get_index_dtype(maxval=cells.size))
        parts = _assemble(np.ascontiguousarray(cells), corners, self.n_dofs // self.dim, numbers_like)
        return sparse.csr_matrix(parts, shape=(self.n_dofs, self.n_dofs))


def number_cell_dofs(mesh: Mesh) -> IntArray:
    """Give the dofs of each cell's nodes, (n_cells, n_monomials dim), node-major; where it lacks some, its first's."""
    return (pad_cells(mesh)[:, :, None] * mesh.dim + np.arange(mesh.dim)).reshape(mesh.n_cells, -1)


def interpolate_cells(mesh: Mesh) -> CellInterpolation:
    """Prepare the interpolation in the cells of a mesh."""
    shapes = np.stack([pad_shapes(block.type, mesh.n_monomials) for block in mesh.cell_blocks])
    kinds = np.empty(mesh.n_cells, dtype=np.int64)
    for place, block in enumerate(mesh.cell_blocks):
        kinds[block.cells] = place
    return CellInterpolation(compute_geometry(mesh), shapes, kinds, number_cell_dofs(mesh), mesh.n_dofs)


# Compiled, since products of many small matrices by numpy took a third of a pass over a subdomain of 33,000 px.


@numba.njit(cache=True, nogil=True)
def _expand(q, cell_dofs, kinds, shapes, coefficients):  # type: ignore[no-untyped-def]
    """Write sum_a q_a T_am of every cell and component into coefficients (n_cells, dim, n_monomials)."""
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


# Node by node: scipy's way from single entries would hold, and sort, four times as many as are left.


@numba.njit(nogil=True)
def _list_cells_of_nodes(corners, n_nodes):  # type: ignore[no-untyped-def]
    """Cells about node i, rising: cells_of[cell_ptr[i]:cell_ptr[i + 1]], as often as i is a corner of each."""
    n_cells, n_corners = corners.shape
    cell_ptr = np.zeros(n_nodes + 1, np.int64)
    for e in range(n_cells):
        for a in range(n_corners):
            cell_ptr[corners[e, a] + 1] += 1
    cell_ptr = np.cumsum(cell_ptr)
    free, cells_of = cell_ptr[:-1].copy(), np.empty(n_cells * n_corners, np.int64)
    for e in range(n_cells):
        for a in range(n_corners):
            cells_of[free[corners[e, a]]] = e
            free[corners[e, a]] += 1
    return cell_ptr, cells_of


@numba.njit(nogil=True)
def _find_neighbours(corners, cell_ptr, cells_of):  # type: ignore[no-untyped-def]
    """Nodes that share a cell with node i, itself too, rising: neighbours[pair_ptr[i]:pair_ptr[i + 1]]."""
    n_nodes, n_corners = len(cell_ptr) - 1, corners.shape[1]
    pair_ptr = np.zeros(n_nodes + 1, np.int64)
    neighbours = np.empty(len(cells_of) * n_corners, np.int64)
    for i in range(n_nodes):
        begin = end = pair_ptr[i]
        for k in range(cell_ptr[i], cell_ptr[i + 1]):
            for a in range(n_corners):
                j, place = corners[cells_of[k], a], end
                while place > begin and neighbours[place - 1] > j:
                    place -= 1
                if place > begin and neighbours[place - 1] == j:
                    continue
                for later in range(end, place, -1):
                    neighbours[later] = neighbours[later - 1]
                neighbours[place] = j
                end += 1
        pair_ptr[i + 1] = end
    return pair_ptr, neighbours[:pair_ptr[-1]].copy()


@numba.njit(nogil=True)
def _number_entries(pair_ptr, neighbours, dim, indptr, indices):  # type: ignore[no-untyped-def]
    """Write where rows begin, and their columns: the dim rows of node i have the entries from dim^2 pair_ptr[i] on."""
    for i in range(len(pair_ptr) - 1):
        first, n_beside = pair_ptr[i], pair_ptr[i + 1] - pair_ptr[i]
        for d in range(dim):
            row = dim * (dim * first + d * n_beside)
            indptr[i * dim + d + 1] = row + dim * n_beside
            for k in range(n_beside):
                for c in range(dim):
                    indices[row + k * dim + c] = neighbours[first + k] * dim + c


@numba.njit(nogil=True)
def _add_corner(matrix, a, to, dim, beside, first, data):  # type: ignore[no-untyped-def]
    """Add the rows of a cell's corner a to those of its node: nodes beside it, entries from ``first`` on."""
    for b in range(len(to)):
        place = np.searchsorted(beside, to[b])
        for d in range(dim):
            row = first + dim * (d * len(beside) + place)
            for c in range(dim):
                data[row + c] += matrix[a * dim + d, b * dim + c]


@numba.njit(cache=True, nogil=True)
def _assemble(cells, corners, n_nodes, numbers_like):  # type: ignore[no-untyped-def]
    """Data, column numbers and row pointers of the sum of cell matrices between their corners (n, n_monomials)."""
    dim = cells.shape[1] // corners.shape[1]
    cell_ptr, cells_of = _list_cells_of_nodes(corners, n_nodes)
    pair_ptr, neighbours = _find_neighbours(corners, cell_ptr, cells_of)
    data = np.zeros(dim * dim * len(neighbours))
    indices = np.empty(len(data), numbers_like.dtype)
    indptr = np.zeros(n_nodes * dim + 1, numbers_like.dtype)
    _number_entries(pair_ptr, neighbours, dim, indptr, indices)
    # Cell by cell, so that every entry has the same sum whichever cells there are besides those about it.
    for e in range(len(cells)):
        for a in range(corners.shape[1]):
            i = corners[e, a]
            beside = neighbours[pair_ptr[i]:pair_ptr[i + 1]]
            _add_corner(cells[e], a, corners[e], dim, beside, dim * dim * pair_ptr[i], data)
    return data, indices, indptr
