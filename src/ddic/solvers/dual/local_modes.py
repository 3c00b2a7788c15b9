"""Low-energy modes of a subdomain: the lowest eigenvectors of A_s."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from ddic.mesh.mesh import Mesh
from ddic.solvers.local_operator import LocalOperator

_SWEEPS = 4
_EXTRA = 8


def low_energy_modes(matrix: sparse.csr_matrix, operator: LocalOperator, mesh: Mesh,
                     n_modes: int) -> NDArray[np.float64]:
    """Lowest eigenvectors of A_s by block inverse iteration from polynomials, (n_dofs, at most n_modes).

    matrix, operator: A_s and its factor; every sweep is one solve with a block of vectors. A few sweeps are
    enough: smooth fields are nearly the modes sought, and a coarse space needs their span, not each of them.
    """
    wanted = min(n_modes, mesh.n_dofs)
    block = _orthonormal(_start(mesh, min(wanted + _EXTRA, mesh.n_dofs)))
    for _ in range(_SWEEPS):
        block = _orthonormal(operator.solve_many(block))
    _, rotation = linalg.eigh(block.T @ (matrix @ block), subset_by_index=[0, min(wanted, block.shape[1]) - 1])
    return np.asarray(block @ rotation)


def _start(mesh: Mesh, size: int) -> NDArray[np.float64]:
    """Polynomials of rising degree in each component, filled up with random vectors, (n_dofs, size)."""
    centred = mesh.nodes - mesh.nodes.mean(axis=0)
    x = centred / max(float(np.abs(centred).max()), 1e-300)
    start = np.random.default_rng(0).standard_normal((mesh.n_dofs, size))
    column = 0
    for exponents in _exponents(mesh.dim, size):
        for component in range(mesh.dim):
            if column == size:
                return start
            field = np.zeros((mesh.n_nodes, mesh.dim))
            field[:, component] = np.prod(x ** np.array(exponents), axis=1)
            start[:, column] = field.ravel()
            column += 1
    return start


def _exponents(dim: int, n: int) -> list[tuple[int, ...]]:
    """Exponents of at least n / dim monomials, lowest degree first."""
    found: list[tuple[int, ...]] = []
    degree = 0
    while dim * len(found) < n:
        found += [e for e in np.ndindex(*(degree + 1,) * dim) if sum(e) == degree]
        degree += 1
    return found


def _orthonormal(block: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(linalg.qr(block, mode="economic")[0])
