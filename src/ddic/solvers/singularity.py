"""Whether a factorised operator is singular, and what to tell of it."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from ddic.solvers.petsc_stack import PetscStack

_PROBES = 3
"""Inverse iterations: each brings the bound nearer to the lowest eigenvalue and costs a solve."""


def bound_lowest_eigenvalue(factor: PETSc.Mat, probe: PETSc.Vec) -> float:
    """Bound the lowest eigenvalue from above by a few inverse iterations.

    Parameters
    ----------
    factor : PETSc.Mat
        Of a symmetric positive definite matrix.
    probe : PETSc.Vec
        Random; becomes the last iterate.

    Returns
    -------
    float
        The bound, in the matrix's unit; 0 where the iterations break down.
    """
    with PetscStack() as stack:
        solution = stack.keep(probe.duplicate())
        bound = np.inf
        for _ in range(_PROBES):
            probe.normalize()
            factor.solve(probe, solution)
            size = solution.norm()
            if not np.isfinite(size):
                return 0.0
            bound = 1.0 / size
            solution.copy(probe)
        return float(bound)


_SINGULAR = ": the operator is singular"


def describe_singular(where: str) -> str:
    """Write the message that an operator is singular.

    Parameters
    ----------
    where : str
        What it belongs to.

    Returns
    -------
    str
        With causes and remedies.
    """
    return (f"{where}{_SINGULAR}, which means that the reference image has too little texture "
            "there, or too few pixels that are neither masked nor mapped outside the deformed image; use larger "
            "elements, leave the blank part out of the mesh, or give a longer regularization.cut_off_wavelength")


def describe_lost(message: str, reason: str) -> str:
    """Give such a message another reason: not the reference image, but what a frame shows of it."""
    return f"{message.partition(_SINGULAR)[0]}{_SINGULAR}: {reason}"
