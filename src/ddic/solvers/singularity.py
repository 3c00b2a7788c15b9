"""Whether a factorised operator is singular, and what to tell of it."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

_PROBES = 3


def lowest_eigenvalue_estimate(factor: PETSc.Mat, probe: PETSc.Vec) -> float:
    """Upper bound of the lowest eigenvalue by a few inverse iterations; 0 where they break down.

    factor: of a symmetric positive definite matrix; probe: random, becomes the last iterate.
    """
    estimate = np.inf
    solution = probe.duplicate()
    for _ in range(_PROBES):
        probe.normalize()
        factor.solve(probe, solution)
        size = solution.norm()
        if not np.isfinite(size):
            estimate = 0.0
            break
        estimate = 1.0 / size
        solution.copy(probe)
    solution.destroy()
    return float(estimate)


def singular(where: str) -> str:
    """The message that an operator is singular; where: what it belongs to."""
    return (f"{where}: the operator is singular, which means that the reference image has too little texture "
            "there, or too few pixels that are neither masked nor mapped outside the deformed image; use larger "
            "elements, leave the blank part out of the mesh, or give a longer regularization.cut_off_wavelength")
