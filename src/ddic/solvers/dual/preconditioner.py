"""The block explicit-inverse preconditioner of the interface problem, Eq. 37-40 of [BP17]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import linalg, sparse

from ddic.errors import SingularSubdomainError
from ddic.solvers.dual.local_dual import LocalDual
from ddic.solvers.dual.sparse_inverse import SINGULAR_INTERFACE
from ddic.solvers.exchange import Exchange

SINGULAR_PIVOT = 1e-14
"""Pivot of Cholesky, relative to the diagonal entry that it is what is left of, below which it is rounding: some tens
of the precision of a number."""


def local_schur(local: LocalDual) -> NDArray[np.float64]:
    """S_s = T_s A_s^-1 T_s^T - D_s of one subdomain, dense and symmetric."""
    schur = local.schur_product(np.eye(len(local.compliance)))
    return np.asarray(0.5 * (schur + schur.T))


def block_inverse(schur: NDArray[np.float64], n_displacement: int) -> NDArray[np.float64]:
    """Invert S_s by blocks, Eq. 37-40 of [BP17] with the misprints of Eq. 38 put right.

    With a = S^ll, b = S^l(lbar), d = S^(lbar)(lbar) - b^T a^-1 b the inverse is
    [[a^-1 + a^-1 b d^-1 b^T a^-1, -a^-1 b d^-1], [-d^-1 b^T a^-1, d^-1]]; a and -d are positive definite.
    """
    n = n_displacement
    a_inverse = _inverse(schur[:n, :n])
    if n == len(schur):
        return a_inverse
    b = schur[:n, n:]
    ab = a_inverse @ b
    d_inverse = -_inverse(b.T @ ab - schur[n:, n:])
    out = np.empty_like(schur)
    out[:n, n:] = -ab @ d_inverse
    out[n:, :n] = out[:n, n:].T
    out[:n, :n] = a_inverse - out[:n, n:] @ ab.T
    out[n:, n:] = d_inverse
    return out


def _inverse(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    try:
        factor = linalg.cho_factor(matrix, lower=True)
    except linalg.LinAlgError as error:
        raise SingularSubdomainError(SINGULAR_INTERFACE) from error
    # Whether the pivot of a null vector comes out negative is rounding's choice.
    if (factor[0].diagonal() ** 2 <= SINGULAR_PIVOT * matrix.diagonal()).any():
        raise SingularSubdomainError(SINGULAR_INTERFACE)
    inverse = linalg.cho_solve(factor, np.eye(len(matrix)))
    return np.asarray(0.5 * (inverse + inverse.T))


class LocalInverse(Protocol):
    """S_s^-1 of one subdomain, dense or factorised."""

    def apply(self, r: NDArray[np.float64]) -> NDArray[np.float64]:
        """S_s^-1 r on the subdomain's own interface dofs, (n interface dofs,)."""
        ...

    def destroy(self) -> None:
        """Free what PETSc holds."""
        ...


@dataclass(frozen=True)
class DenseInverse:
    """S_s^-1 as an array, (n interface dofs, n interface dofs), of ``block_inverse``."""

    matrix: NDArray[np.float64]

    def apply(self, r: NDArray[np.float64]) -> NDArray[np.float64]:
        """S_s^-1 r on the subdomain's own interface dofs, (n interface dofs,)."""
        return np.asarray(self.matrix @ r)

    def destroy(self) -> None:
        """Nothing: the array is Python's."""


@dataclass(frozen=True)
class LocalPreconditioner:
    """One subdomain's term B S_s^-1 B^T.

    assembly: B, (n ghost rows, n interface dofs): signed incidence, or its scaled version;
    inverse: S_s^-1.
    """

    assembly: sparse.csr_matrix
    inverse: LocalInverse

    def apply(self, r: NDArray[np.float64]) -> NDArray[np.float64]:
        """B S_s^-1 B^T r on ghost rows."""
        return np.asarray(self.assembly @ self.inverse.apply(self.assembly.T @ r))


class DualPreconditioner:
    """Context of PETSc's shell preconditioner: P r = sum_s B_s S_s^-1 B_s^T r, Eq. 37 of [BP17]."""

    def __init__(self, exchange: Exchange, locals_: Sequence[LocalPreconditioner]) -> None:
        self._exchange = exchange
        self._locals = locals_

    def apply(self, _: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """PETSc's callback for y = P x."""
        r = self._exchange.to_ghosts(x)
        total = np.zeros_like(r)
        for local in self._locals:
            total += local.apply(r)
        self._exchange.add_to_owners(total, y)

    applyTranspose = apply
