"""Whether S_s^-1 of a subdomain is held as an array or as a sparse factor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ddic.solvers.dual.local_dual import LocalDual
from ddic.solvers.dual.preconditioner import DenseInverse, LocalInverse, block_inverse, local_schur
from ddic.solvers.dual.sparse_inverse import SparseInverse
from ddic.solvers.local_system import LocalSystem

LocalInverseKind = Literal["auto", "dense", "sparse"]

DENSE_ARRAYS = 5
"""Arrays of the size of S_s at the peak of the dense way: S_s, its inverse, and those ``block_inverse`` works with."""

DENSE_LIMIT = 2**26
"""Bytes that the dense way of one subdomain may take: 1295 interface dofs, some 80 x 80 elements with neighbours all
round. bench/local_inverse.py finds the array faster in an iteration and slower to set up at 50 x 50 and 100 x 100
elements, with the same memory within 30 MiB; the limit lies between, where several subdomains a rank stay cheap."""


@dataclass(frozen=True)
class SchurPair:
    """A subdomain's S_s and S_s^-1; product: from X to S_s X, both (n interface dofs, k)."""

    product: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    inverse: LocalInverse


def is_dense(n_interface: int, kind: LocalInverseKind) -> bool:
    """Whether S_s and its inverse are to be arrays; n_interface: its size."""
    return kind == "dense" or (kind == "auto" and 8 * DENSE_ARRAYS * n_interface**2 <= DENSE_LIMIT)


def schur_pair(system: LocalSystem, local: LocalDual, kind: LocalInverseKind) -> SchurPair:
    """S_s and its inverse, by arrays or by sparse factors; raises SingularSubdomainError."""
    if is_dense(len(local.compliance), kind):
        schur = local_schur(local)
        return SchurPair(schur.__matmul__, DenseInverse(block_inverse(schur, local.n_displacement)))
    return SchurPair(local.schur_product, SparseInverse(system.operator, local))
