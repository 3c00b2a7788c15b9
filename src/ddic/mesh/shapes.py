"""Shape functions of T3 and Q4 cells, written on one set of monomials (1, xi, eta, xi eta)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.mesh import VTK_QUAD, VTK_TRIANGLE, Mesh

N_MONOMIALS = 4

_Q4_CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])

SHAPE_COEFFICIENTS: dict[int, NDArray[np.float64]] = {
    VTK_TRIANGLE: np.array(
        [[1.0, -1.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 0.0]]
    ),
    VTK_QUAD: 0.25 * np.stack(
        [np.ones(4), _Q4_CORNERS[:, 0], _Q4_CORNERS[:, 1], _Q4_CORNERS[:, 0] * _Q4_CORNERS[:, 1]], axis=1
    ),
}
"""N_a = sum_m SHAPE_COEFFICIENTS[type][a, m] phi_m with phi = (1, xi, eta, xi eta)."""

QUADRATURE: dict[int, tuple[NDArray[np.float64], NDArray[np.float64]]] = {
    VTK_TRIANGLE: (np.array([[1 / 3, 1 / 3]]), np.array([0.5])),
    VTK_QUAD: (_Q4_CORNERS / np.sqrt(3.0), np.ones(4)),
}
"""Points (n, 2) and weights (n,) that integrate the stiffness of an undistorted cell exactly."""

CENTRES: dict[int, NDArray[np.float64]] = {
    VTK_TRIANGLE: np.array([[1 / 3, 1 / 3]]),
    VTK_QUAD: np.array([[0.0, 0.0]]),
}


def monomials(local: NDArray[np.float64]) -> NDArray[np.float64]:
    """Evaluate (1, xi, eta, xi eta) at local points (n, 2); returns (n, 4)."""
    xi, eta = local[:, 0], local[:, 1]
    return np.stack([np.ones_like(xi), xi, eta, xi * eta], axis=1)


def monomial_gradients(local: NDArray[np.float64]) -> NDArray[np.float64]:
    """Differentiate the monomials by (xi, eta) at local points (n, 2); returns (n, 4, 2)."""
    xi, eta = local[:, 0], local[:, 1]
    zero, one = np.zeros_like(xi), np.ones_like(xi)
    by_xi = np.stack([zero, one, zero, eta], axis=1)
    by_eta = np.stack([zero, zero, one, xi], axis=1)
    return np.stack([by_xi, by_eta], axis=2)


def nodal_to_monomial(mesh: Mesh) -> NDArray[np.float64]:
    """Shape coefficients of every cell, (n_cells, 4 nodes, 4 monomials); a T3's fourth row is zero."""
    table = np.zeros((256, N_MONOMIALS, N_MONOMIALS))
    for cell_type, coefficients in SHAPE_COEFFICIENTS.items():
        table[cell_type] = coefficients
    return table[mesh.types]


def padded_cells(mesh: Mesh) -> NDArray[np.int64]:
    """Nodes of each cell, (n_cells, 4); a T3 repeats its first node (its fourth shape is zero)."""
    cells = np.full((mesh.n_cells, N_MONOMIALS), -1, dtype=np.int64)
    cells[:, : mesh.cells.shape[1]] = mesh.cells
    return np.where(cells < 0, cells[:, :1], cells)


def geometry_coefficients(mesh: Mesh) -> NDArray[np.float64]:
    """Coefficients X of the map x = sum_m X_m phi_m(xi, eta) of every cell, (n_cells, 2, 4), pixels."""
    coordinates = mesh.nodes[padded_cells(mesh)]
    return np.ascontiguousarray(np.einsum("eam,eac->ecm", nodal_to_monomial(mesh), coordinates))


def shape_gradients(mesh: Mesh, cells: NDArray[np.int64], local: NDArray[np.float64],
                    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Gradients of the shape functions of cells of one type at one local point per row.

    cells: cell numbers (n,), all of one type; local: (n_points, 2).
    Returns dN/dx of shape (n, n_points, k, 2) in 1/px, k nodes per cell, and det J (n, n_points).
    """
    cell_type = int(mesh.types[cells[0]])
    n_cell_nodes = int((mesh.cells[cells[0]] >= 0).sum())
    coordinates = mesh.nodes[mesh.cells[cells][:, :n_cell_nodes]]
    by_local = np.einsum("am,pmj->paj", SHAPE_COEFFICIENTS[cell_type][:n_cell_nodes], monomial_gradients(local))
    jacobian = coordinates.transpose(0, 2, 1)[:, None] @ by_local
    inverse, det = _inverse_and_determinant(jacobian)
    return by_local @ inverse, det


def _inverse_and_determinant(matrices: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Of many matrices (..., dim, dim); by the closed form in two dimensions, ten times as fast."""
    if matrices.shape[-1] != 2:
        return np.linalg.inv(matrices), np.linalg.det(matrices)
    a, b, c, d = (matrices[..., i, j] for i in range(2) for j in range(2))
    det = a * d - b * c
    adjugate = np.stack([d, -b, -c, a], axis=-1).reshape(matrices.shape)
    return adjugate / det[..., None, None], det
