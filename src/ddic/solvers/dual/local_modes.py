"""Low-energy modes of a subdomain: the lowest eigenvectors of A_s with softened interface rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.local_system import LocalSystem

SOFTENING = 0.03
"""Weight of the interface rows of Kbar_s in the energy whose modes are sought. A reaction at the interface is balanced
by the neighbours' in the coupled problem, so that A_s with its full rows counts as stiff what the whole finds soft."""

FEW, MANY = 16, 40
"""Modes a subdomain: few where texture alone holds the lowest modes (l_c below the subdomain's size), else many."""

FLAT = 10.0
"""The spectrum counts as flat, hence held by texture, where the last of the few is below this many times the first."""

_SWEEPS = 4
_EXTRA = 8


def low_energy_modes(system: LocalSystem, operator: LocalOperator) -> NDArray[np.float64]:
    """Lowest eigenvectors of A_s with softened interface rows, (n_dofs, FEW or MANY of them).

    system, operator: the subdomain and the factor of A_s. Block inverse iteration from polynomials, every sweep one
    solve with a block of vectors. A few sweeps are enough: smooth fields are nearly the modes sought, and a coarse
    space needs their span, not each of them.
    """
    nodes = system.subdomain.nodes
    matrix = _softened(system)
    factor = operator if system.controlled_stiffness is None else LocalOperator(
        matrix, smallest_eigenvalue=0.0, where="softened subdomain")
    # More modes than half the interface dofs would make the coarse problem the interface problem.
    wanted = min(MANY, nodes.size, max(len(system.subdomain.displacement.dofs) // 2, 1))
    block = _orthonormal(_start(nodes, min(wanted + _EXTRA, nodes.size)))
    for _ in range(_SWEEPS):
        block = _orthonormal(factor.solve_many(block))
    if factor is not operator:
        factor.destroy()
    energies, rotation = linalg.eigh(block.T @ (matrix @ block))
    few = min(FEW, wanted)
    kept = few if energies[few - 1] < FLAT * energies[0] else wanted
    return np.asarray(block @ rotation[:, :kept])


def _softened(system: LocalSystem) -> sparse.csr_matrix:
    if system.controlled_stiffness is None:
        return system.operator
    weights = np.ones(system.controlled_stiffness.shape[0])
    weights[system.subdomain.reaction.dofs] = np.sqrt(SOFTENING)
    softened = (sparse.diags(weights) @ system.controlled_stiffness).tocsr()
    return replace(system, controlled_stiffness=softened).operator


def _start(nodes: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """Polynomials of rising degree in each component, filled up with random vectors, (n_dofs, size)."""
    centred = nodes - nodes.mean(axis=0)
    x = centred / max(float(np.abs(centred).max()), 1e-300)
    start = np.random.default_rng(0).standard_normal((nodes.size, size))
    column = 0
    for exponents in _exponents(nodes.shape[1], size):
        for component in range(nodes.shape[1]):
            if column == size:
                return start
            field = np.zeros(nodes.shape)
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
