"""Low-energy modes of a subdomain: the lowest eigenvectors of A_s with softened interface rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from ddic.functionals.scale_rows import scale_rows
from ddic.kinematics.kinematics import Kinematics
from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.petsc_stack import PetscStack

SOFTENING = 0.03
"""Weight of the interface rows of Kbar_s in the energy whose modes are sought. A reaction at the interface is balanced
by the neighbours' in the coupled problem, so that A_s with its full rows counts as stiff what the whole finds soft."""

FEW, MANY = 16, 40
"""Modes a subdomain: few where texture alone holds the lowest modes (l_c below the subdomain's size), else many. More
save iterations and make the coarse problem larger."""

FLAT = 10.0
"""The spectrum counts as flat, hence held by texture, where the last of the few is below this many times the first."""

_SWEEPS = 4
"""Inverse iterations: more bring the block nearer to the eigenvectors, each for a solve with all its columns."""

_EXTRA = 8
"""Vectors beyond those wanted, which make the iteration converge faster."""


def find_low_energy_modes(system: LocalSystem, operator: LocalOperator) -> NDArray[np.float64]:
    """Find the lowest eigenvectors of A_s with softened interface rows, by block inverse iteration from polynomials.

    A few sweeps are enough: smooth fields are nearly the modes sought, and a coarse space needs their span, not each
    of them.

    Parameters
    ----------
    system : LocalSystem
        The subdomain, without the motion of its camera.
    operator : LocalOperator
        Its A_s factorised.

    Returns
    -------
    (n_field, FEW or MANY, or fewer) array
        Modes, orthonormal.
    """
    kinematics = system.subdomain.kinematics
    # More modes than half the interface unknowns would make the coarse problem the interface problem.
    n_useful = max(len(system.subdomain.jumps.unknowns) // 2, 1)
    n_wanted = min(MANY, kinematics.n_unknowns, n_useful)
    n_columns = min(n_wanted + _EXTRA, kinematics.n_unknowns)
    matrix = _soften(system)
    with PetscStack() as stack:
        factor = operator
        if system.controlled_stiffness is not None:
            factor = stack.keep(LocalOperator(matrix, smallest_eigenvalue=0.0, where="softened subdomain"))
        block = _orthonormalize(_make_start(kinematics, n_columns))
        for _ in range(_SWEEPS):
            block = _orthonormalize(factor.solve_many(block))
    energies, rotation = linalg.eigh(block.T @ (matrix @ block))
    n_few = min(FEW, n_wanted)
    is_flat = energies[n_few - 1] < FLAT * energies[0]
    n_kept = n_few if is_flat else n_wanted
    return np.asarray(block @ rotation[:, :n_kept])


def _soften(system: LocalSystem) -> sparse.csr_matrix:
    """A_s with the interface rows of Kbar_s weighted by SOFTENING, (n_field, n_field)."""
    if system.controlled_stiffness is None:
        return system.operator
    weights = np.ones(system.controlled_stiffness.shape[0])
    weights[system.subdomain.reactions.unknowns] = np.sqrt(SOFTENING)
    softened = scale_rows(system.controlled_stiffness, weights)
    return replace(system, stiffness=softened, projection=None).operator


def _make_start(kinematics: Kinematics, n_columns: int) -> NDArray[np.float64]:
    """Unknowns that fit polynomials of rising degree in each component, filled up with random vectors."""
    nodes = kinematics.mesh.nodes
    centred = nodes - nodes.mean(axis=0)
    x = centred / max(float(np.abs(centred).max()), 1e-300)
    dim = kinematics.mesh.dim
    start = np.random.default_rng(0).standard_normal((kinematics.n_unknowns, n_columns))
    fields = [(exponents, component) for exponents in _list_exponents(dim, n_columns) for component in range(dim)]
    for column, (exponents, component) in enumerate(fields[:n_columns]):
        field = np.zeros(nodes.shape)
        field[:, component] = np.prod(x ** np.array(exponents), axis=1)
        start[:, column] = kinematics.fit(field.ravel())
    return start


def _list_exponents(dim: int, n: int) -> list[tuple[int, ...]]:
    """Exponents of at least n / dim monomials, lowest degree first."""
    found: list[tuple[int, ...]] = []
    degree = 0
    while dim * len(found) < n:
        found += [e for e in np.ndindex(*(degree + 1,) * dim) if sum(e) == degree]
        degree += 1
    return found


def _orthonormalize(block: NDArray[np.float64]) -> NDArray[np.float64]:
    """An orthonormal basis of the columns, (n, k)."""
    return np.asarray(linalg.qr(block, mode="economic")[0])
