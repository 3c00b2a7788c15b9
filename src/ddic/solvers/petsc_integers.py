"""Numbers as PETSc's integers, which have 32 bits in most builds."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from ddic.errors import FactorizationError

LARGEST = int(np.iinfo(PETSc.IntType).max)
"""Largest of PETSc's integers: of rows, columns, and entries of a rank's part of a matrix."""


def to_petsc_integers(numbers: NDArray[Any], what: str) -> NDArray[Any]:
    """Convert numbers to PETSc's integers; a plain cast would turn those that are too large into others.

    Parameters
    ----------
    numbers : (n,) array of integers
        Not negative.
    what : str
        What is counted, for the message.

    Returns
    -------
    (n,) array of PETSc.IntType
        The same numbers.

    Raises
    ------
    FactorizationError
        Where one is too large.
    """
    check_petsc_size(int(numbers.max(initial=0)), what)
    return numbers.astype(PETSc.IntType)


def check_petsc_size(size: int, what: str) -> None:
    """Check that a size is one of PETSc's integers.

    Parameters
    ----------
    size : int
        Not negative.
    what : str
        What is counted, for the message.

    Raises
    ------
    FactorizationError
        Where it is too large.
    """
    if size > LARGEST:
        raise FactorizationError(
            f"{what}: {size} is more than PETSc's {8 * np.dtype(PETSc.IntType).itemsize}-bit integers hold; start more "
            "ranks, give larger elements, or build PETSc with --with-64-bit-indices")
