"""One cycle of multigrid by smoothed aggregation, an approximate inverse, and its transpose.

PETSc's GAMG coarsens, this module cycles: by polynomials that need no lower bound of the spectrum, with other numbers of
steps before the coarse correction than after it. The transpose of such a cycle is the cycle with these numbers swapped.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from petsc4py import PETSc

from ddic.arrays import Array
from ddic.solvers.petsc import MULTIGRID, PetscOwner, PetscStack, create_ksp

POWER_ITERATIONS = 10
"""By which the largest eigenvalue is estimated."""

BEYOND = 1.1
"""Times that estimate, which comes from below, up to which the polynomials damp. A larger factor damps less."""

NOTHING = 1e-12
"""Diagonal entry, relative to the largest, below which a coarse vector is none: as all of a single node's are that
another one has."""


class _Level(PetscOwner):
    """A matrix of the hierarchy, and how its solutions are smoothed."""

    def __init__(self, matrix: PETSc.Mat) -> None:
        with PetscStack() as stack:
            self.matrix = matrix
            self.right, self.solution, self.residual, self._step, self._change, self._weights = (
                stack.keep(matrix.createVecRight()) for _ in range(6))
            matrix.getDiagonal(self._weights)
            diagonal = self._weights.getArray()
            is_something = diagonal > NOTHING * self._weights.norm(PETSc.NormType.INFINITY)
            diagonal[:] = np.where(is_something, 1.0, 0.0) / np.where(is_something, diagonal, 1.0)
            self._weights.scale(4.0 / (BEYOND * self._find_largest_eigenvalue()))
            self._objects = stack.pop_all()

    def _find_largest_eigenvalue(self) -> float:
        """That of the matrix over its diagonal, from below."""
        size = 1.0
        self._step.setRandom()
        for _ in range(POWER_ITERATIONS):
            self.matrix.mult(self._step, self._change)
            self._step.pointwiseMult(self._weights, self._change)
            size = float(self._step.normalize())
        return size

    def find_residual(self, right: PETSc.Vec, solution: PETSc.Vec) -> None:
        """Set the residual to right - B solution."""
        self.matrix.mult(solution, self.residual)
        self.residual.aypx(-1.0, right)

    def smooth(self, solution: PETSc.Vec, n_steps: int) -> None:
        """Improve a solution, whose residual is at hand, by the Chebyshev polynomial of the fourth kind of a degree."""
        step, change = self._step, self._change
        step.set(0.0)
        for k in range(n_steps):
            change.pointwiseMult(self._weights, self.residual)
            step.axpby((2 * k + 1) / (2 * k + 3), max(2 * k - 1, 0) / (2 * k + 3), change)
            solution.axpy(1.0, step)
            if k + 1 < n_steps:
                self.matrix.mult(step, change)
                self.residual.axpy(-1.0, change)


class Multigrid(PetscOwner):
    """Approximates the inverse of a symmetric positive definite matrix of second order by a cycle.

    PETSc options (prefix ``multigrid_``): ``-multigrid_pc_gamg_threshold`` and others of the coarsening.

    Parameters
    ----------
    matrix : PETSc.Mat
        B, of type AIJ, with what its differential operator does not see as near-null space; only asked here.
    blocks : PETSc.Mat
        The same of type BAIJ, in which a product takes a third of the time; remains its maker's to destroy.
    """

    def __init__(self, matrix: PETSc.Mat, blocks: PETSc.Mat) -> None:
        with PetscStack() as stack, PetscStack() as temporary:
            ksp = temporary.keep(create_ksp(matrix.getComm(), MULTIGRID))
            ksp.setOperators(matrix)
            ksp.setFromOptions()
            ksp.setUp()
            pc = ksp.getPC()
            n_levels = pc.getMGLevels()
            self._coarsest = stack.keep(pc.getMGCoarseSolve())
            # From the finest to the coarsest.
            matrices = [blocks] + [stack.keep(pc.getMGSmoother(k).getOperators()[0]) for k in range(n_levels - 2, -1, -1)]
            self._transfers = [stack.keep(pc.getMGInterpolation(k)) for k in range(n_levels - 1, 0, -1)]
            self._levels = [stack.keep(_Level(matrix)) for matrix in matrices]
            self._objects = stack.pop_all()

    def apply(self, right: PETSc.Vec, solution: PETSc.Vec, before: int, after: int) -> None:
        """Set a solution to the cycle's, with so many steps of smoothing before and after coarse corrections."""
        self._cycle(0, right, solution, before, after)

    def _cycle(self, number: int, right: PETSc.Vec, solution: PETSc.Vec, before: int, after: int) -> None:
        level = self._levels[number]
        if number + 1 == len(self._levels):
            self._coarsest.solve(right, solution)
            return
        solution.set(0.0)
        right.copy(level.residual)
        level.smooth(solution, before)
        level.find_residual(right, solution)
        coarse, transfer = self._levels[number + 1], self._transfers[number]
        transfer.multTranspose(level.residual, coarse.right)
        self._cycle(number + 1, coarse.right, coarse.solution, before, after)
        transfer.multAdd(coarse.solution, solution, solution)
        level.find_residual(right, solution)
        level.smooth(solution, after)
