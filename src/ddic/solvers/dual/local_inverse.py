"""Whether S_s^-1 of a subdomain is held as an array or as a sparse factor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ddic.solvers.dual.local_dual import LocalDual
from ddic.solvers.dual.preconditioner import DenseInverse, LocalInverse, assemble_schur, invert_by_blocks
from ddic.solvers.dual.sparse_inverse import SparseInverse
from ddic.solvers.factor_packages import is_mumps_missing
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.petsc_defaults import INVERSE

LocalInverseKind = Literal["auto", "dense", "sparse"]

DENSE_ARRAYS = 5
"""Arrays of the size of S_s at the peak of the dense way: S_s, its inverse, and those of ``invert_by_blocks``."""

DENSE_LIMIT = 2**26
"""Bytes that the dense way of one subdomain may take: 1295 interface unknowns, some 80 x 80 elements with neighbours
all round. bench/local_inverse.py finds the array faster in an iteration and slower to set up at 50 x 50 and 100 x 100
elements, with the same memory within 30 MiB; the limit lies between, where several subdomains a rank stay cheap."""


@dataclass(frozen=True)
class SchurPair:
    """A subdomain's S_s and S_s^-1.

    Attributes
    ----------
    multiply : callable
        From X to S_s X, both of shape (n interface unknowns, k).
    inverse : LocalInverse
        S_s^-1.
    """

    multiply: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    inverse: LocalInverse


def is_dense(n_interface: int, kind: LocalInverseKind) -> bool:
    """Tell whether S_s and its inverse are to be arrays.

    Parameters
    ----------
    n_interface : int
        Size of S_s.
    kind : LocalInverseKind
        What was asked for.

    Returns
    -------
    bool
        Whether they are: always without MUMPS, which makes the sparse factor.
    """
    if kind == "auto":
        if is_mumps_missing(INVERSE):
            return True
        return 8 * DENSE_ARRAYS * n_interface**2 <= DENSE_LIMIT
    return kind == "dense"


def build_schur_pair(system: LocalSystem, local: LocalDual, kind: LocalInverseKind) -> SchurPair:
    """Build S_s and its inverse, by arrays or by sparse factors.

    Parameters
    ----------
    system : LocalSystem
        The subdomain, the motion of its camera held.
    local : LocalDual
        Its interface operators.
    kind : LocalInverseKind
        By which of the two; "auto" asks its size.

    Returns
    -------
    SchurPair
        The inverse is the caller's to destroy.

    Raises
    ------
    SingularSubdomainError
        Where S_s is singular.
    """
    if is_dense(len(local.compliance), kind):
        schur = assemble_schur(local)
        return SchurPair(schur.__matmul__, DenseInverse(invert_by_blocks(schur, local.n_jumps)))
    return SchurPair(local.multiply_schur, SparseInverse(system.operator, local))
