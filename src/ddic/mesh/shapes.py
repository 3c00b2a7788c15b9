"""Geometry of a mesh's cells: maps from the reference cell, and gradients of the shape functions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.cell_type import CELL_TYPES, CellType
from ddic.mesh.mesh import CellBlock, Mesh
from ddic.mesh.monomials import N_MONOMIALS


def pad_shapes(kind: CellType) -> NDArray[np.float64]:
    """Pad a cell type's shape coefficients to the size that all types have in common.

    Parameters
    ----------
    kind : CellType
        Of at most four nodes.

    Returns
    -------
    (4 nodes, 4 monomials) array
        Coefficients of N_a; the rows of nodes that the type does not have are zero.
    """
    padded = np.zeros((N_MONOMIALS, N_MONOMIALS))
    padded[:kind.n_nodes] = kind.shapes
    return padded


def pad_cells(mesh: Mesh) -> NDArray[np.int64]:
    """Pad the cells' nodes to the number that all types have in common.

    Parameters
    ----------
    mesh : Mesh
        Of cells of at most four nodes.

    Returns
    -------
    (n_cells, 4) int64 array
        Nodes of each cell; one with fewer repeats its first node, whose padded shape is zero.
    """
    cells = np.full((mesh.n_cells, N_MONOMIALS), -1, dtype=np.int64)
    cells[:, :mesh.cells.shape[1]] = mesh.cells
    first = cells[:, :1]
    return np.where(cells < 0, first, cells)


def compute_geometry(mesh: Mesh) -> NDArray[np.float64]:
    """Find the map x = sum_m X_m phi_m(xi, eta) from the reference cell to every cell.

    Parameters
    ----------
    mesh : Mesh
        Any.

    Returns
    -------
    (n_cells, dim, 4 monomials) array
        X, pixels.
    """
    of_type = np.zeros((max(CELL_TYPES) + 1, N_MONOMIALS, N_MONOMIALS))
    for number, kind in CELL_TYPES.items():
        of_type[number] = pad_shapes(kind)
    coordinates = mesh.nodes[pad_cells(mesh)]
    return np.ascontiguousarray(np.einsum("eam,eac->ecm", of_type[mesh.types], coordinates))


def compute_shape_gradients(mesh: Mesh, block: CellBlock,
                    local: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Differentiate the shape functions of cells of one type by x.

    Parameters
    ----------
    mesh : Mesh
        That the cells are of.
    block : CellBlock
        The cells, k nodes each.
    local : (n_points, dim) array
        Points of the reference cell.

    Returns
    -------
    gradients : (n, n_points, k, dim) array
        dN_a / dx_j, 1/px.
    det : (n, n_points) array
        Determinant of the map's Jacobian, square pixels.
    """
    coordinates = mesh.nodes[block.nodes]
    by_local = block.type.differentiate_shapes(local)
    n_points, k, dim = by_local.shape
    # jacobian[e, p, i, j] = dx_i / dxi_j = sum_a x_ai dN_a / dxi_j, one product for all points of a cell.
    at_all_points = coordinates.transpose(0, 2, 1) @ by_local.transpose(1, 0, 2).reshape(k, n_points * dim)
    inverse, det = invert_matrices(at_all_points.reshape(-1, dim, n_points, dim).transpose(0, 2, 1, 3))
    # Not by products of a matrix for each point, which are so small that calling for them takes most of the time.
    gradients = by_local[..., 0, None] * inverse[:, :, None, 0]
    for i in range(1, dim):
        gradients += by_local[..., i, None] * inverse[:, :, None, i]
    return gradients, det


def invert_matrices(matrices: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Invert many small matrices; in two dimensions by the closed form, which is ten times as fast.

    Parameters
    ----------
    matrices : (..., dim, dim) array
        None of them singular.

    Returns
    -------
    inverses : (..., dim, dim) array
        Of each.
    det : (...) array
        Determinants.
    """
    if matrices.shape[-1] != 2:
        return np.linalg.inv(matrices), np.linalg.det(matrices)
    a, b = matrices[..., 0, 0], matrices[..., 0, 1]
    c, d = matrices[..., 1, 0], matrices[..., 1, 1]
    det = a * d - b * c
    adjugate = np.stack([d, -b, -c, a], axis=-1).reshape(matrices.shape)
    return adjugate / det[..., None, None], det
