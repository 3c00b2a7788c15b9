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
from ddic.solvers.dual.rank_dual import list_places
from ddic.solvers.dual.sparse_inverse import SINGULAR_INTERFACE
from ddic.solvers.exchange import Exchange

SINGULAR_PIVOT = 1e-14
"""Pivot of Cholesky, relative to the diagonal entry that it is what is left of, below which it is rounding: some tens
of the precision of a number."""


def assemble_schur(local: LocalDual) -> NDArray[np.float64]:
    """Assemble S_s = T_s A_s^-1 T_s^T - D_s of one subdomain, Eq. 36 of [BP17].

    Parameters
    ----------
    local : LocalDual
        Its interface operators.

    Returns
    -------
    (n interface unknowns, n interface unknowns) array
        S_s, symmetric.
    """
    schur = local.multiply_schur(np.eye(len(local.compliance)))
    return np.asarray(0.5 * (schur + schur.T))


def invert_by_blocks(schur: NDArray[np.float64], n_jumps: int) -> NDArray[np.float64]:
    """Invert S_s by blocks, Eq. 37-40 of [BP17] with the misprints of Eq. 38 put right.

    With a = S^ll, b = S^l(lbar), d = S^(lbar)(lbar) - b^T a^-1 b the inverse is
    [[a^-1 + a^-1 b d^-1 b^T a^-1, -a^-1 b d^-1], [-d^-1 b^T a^-1, d^-1]]; a and -d are positive definite.

    Parameters
    ----------
    schur : (n, n) array
        S_s.
    n_jumps : int
        Size of its first block.

    Returns
    -------
    (n, n) array
        S_s^-1, symmetric.

    Raises
    ------
    SingularSubdomainError
        Where a or -d is not positive definite to rounding.
    """
    n = n_jumps
    a_inverse = _invert_definite(schur[:n, :n])
    if n == len(schur):
        return a_inverse
    b = schur[:n, n:]
    ab = a_inverse @ b
    d_inverse = -_invert_definite(b.T @ ab - schur[n:, n:])
    out = np.empty_like(schur)
    out[:n, n:] = -ab @ d_inverse
    out[n:, :n] = out[:n, n:].T
    out[:n, :n] = a_inverse - out[:n, n:] @ ab.T
    out[n:, n:] = d_inverse
    return out


def _invert_definite(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """The inverse of a symmetric positive definite matrix; raises SingularSubdomainError."""
    try:
        factor = linalg.cho_factor(matrix, lower=True)
    except linalg.LinAlgError as error:
        raise SingularSubdomainError(SINGULAR_INTERFACE) from error
    # Whether the pivot of a null vector comes out negative is rounding's choice.
    pivots = factor[0].diagonal() ** 2
    if (pivots <= SINGULAR_PIVOT * matrix.diagonal()).any():
        raise SingularSubdomainError(SINGULAR_INTERFACE)
    # A third of the operations that the columns of the identity would take; only one triangle is written.
    inverse, _ = linalg.lapack.dpotri(factor[0], lower=True)
    below = np.tril(inverse, -1)
    return np.asarray(below + below.T + np.diag(inverse.diagonal()))


class LocalInverse(Protocol):
    """S_s^-1 of one subdomain, dense or factorised."""

    def apply(self, r: NDArray[np.float64]) -> NDArray[np.float64]:
        """Apply S_s^-1.

        Parameters
        ----------
        r : (n interface unknowns,) array
            r.

        Returns
        -------
        (n interface unknowns,) array
            S_s^-1 r.
        """
        ...

    def destroy(self) -> None:
        """Free what PETSc holds."""
        ...


@dataclass(frozen=True)
class DenseInverse:
    """S_s^-1 as an array.

    Attributes
    ----------
    matrix : (n interface unknowns, n interface unknowns) array
        Of ``invert_by_blocks``.
    """

    matrix: NDArray[np.float64]

    def apply(self, r: NDArray[np.float64]) -> NDArray[np.float64]:
        """Apply S_s^-1.

        Parameters
        ----------
        r : (n interface unknowns,) array
            r.

        Returns
        -------
        (n interface unknowns,) array
            S_s^-1 r.
        """
        return np.asarray(self.matrix @ r)

    def destroy(self) -> None:
        """Nothing to free: the array is Python's."""


@dataclass(frozen=True)
class LocalPreconditioner:
    """One subdomain's term B S_s^-1 B^T.

    Attributes
    ----------
    assembly : (n ghost rows, n interface unknowns) csc_matrix
        B: signed incidence, or its scaled version.
    inverse : LocalInverse
        S_s^-1.
    """

    assembly: sparse.csc_matrix
    inverse: LocalInverse


class DualPreconditioner:
    """Context of PETSc's shell preconditioner: P r = sum_s B_s S_s^-1 B_s^T r, Eq. 37 of [BP17].

    Parameters
    ----------
    exchange : Exchange
        Of interface rows.
    terms : sequence of LocalPreconditioner
        This rank's subdomains.

    Attributes
    ----------
    inverses : list of LocalInverse
        S_s^-1 of each of them.
    """

    def __init__(self, exchange: Exchange, terms: Sequence[LocalPreconditioner]) -> None:
        self._exchange = exchange
        self.inverses = [term.inverse for term in terms]
        self._places = list_places([term.assembly.shape[1] for term in terms])
        # Side by side: to call a product with a small matrix takes longer than to compute it.
        self._assembly = sparse.hstack([term.assembly for term in terms], format="csc").tocsr()
        # Made once: making the matrix takes longer than its product with a vector.
        self._assembly_transposed = self._assembly.T

    def apply(self, _: PETSc.PC | None, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply P: PETSc's callback.

        Parameters
        ----------
        _ : PETSc.PC or None
            Does not matter.
        x : PETSc.Vec
            Residuals r.
        y : PETSc.Vec
            Overwritten by P r.
        """
        self._exchange.add_to_owners(self.apply_own(self._exchange.fetch_ghosts(x)), y)

    applyTranspose = apply

    def apply_own(self, r: NDArray[np.float64]) -> NDArray[np.float64]:
        """Apply the terms of this rank's subdomains; free of communication.

        Parameters
        ----------
        r : (n ghost rows,) array
            Residuals.

        Returns
        -------
        (n ghost rows,) array
            Sum of B_s S_s^-1 B_s^T r.
        """
        on_interfaces = self._assembly_transposed @ r
        solved = [inverse.apply(on_interfaces[place])
                  for inverse, place in zip(self.inverses, self._places, strict=True)]
        return np.asarray(self._assembly @ np.concatenate(solved))
