"""The motion of near-field set-ups in the interface problem: eliminated exactly by the preconditioner."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from ddic.parallel.team import Team
from ddic.solvers.dual.schur_operator import DualSchurOperator
from ddic.solvers.dual.shell import Preconditioning
from ddic.solvers.local_system import LocalSystem


class MotionPreconditioner:
    """Context of PETSc's shell preconditioner for [[S, B], [B^T, -D]] (Lambda, alpha), from P for S alone.

    alpha = (B^T P B + D)^-1 (B^T P r - r_alpha), Lambda = P (r - B alpha): exact where P = S^-1. The rows of alpha are
    the last ones, all on one rank; P takes and gives zeros there.
    """

    def __init__(self, operator: DualSchurOperator, inner: Preconditioning, n_shifts: int, vector: PETSc.Vec) -> None:
        """Apply operator and preconditioner to alpha's columns; vector: one of interface rows. Collective."""
        self._inner = inner
        self._n = n_shifts
        self._comm = operator.comm
        first, last = vector.getOwnershipRange()
        self._here = slice(vector.getSize() - n_shifts - first, last - first) if last > vector.getSize() - n_shifts \
            else None
        unit, column, solved = vector.duplicate(), vector.duplicate(), vector.duplicate()
        columns, products, block = [], [], []
        for k in range(n_shifts):
            unit.set(0.0)
            self._put(unit, np.eye(n_shifts)[k])
            operator.mult(None, unit, column)
            block.append(-self._take(column))
            self._put(column, np.zeros(n_shifts))
            inner.apply(None, column, solved)
            columns.append(np.array(column.getArray()))
            products.append(np.array(solved.getArray()))
        for held in (unit, column, solved):
            held.destroy()
        self._columns, self._products = np.stack(columns, axis=1), np.stack(products, axis=1)
        self._small = self._sum(self._columns.T @ self._products) + np.stack(block, axis=1)

    def apply(self, pc: PETSc.PC | None, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """PETSc's callback for y = P x."""
        given = self._take(x)
        right = x.duplicate()
        x.copy(right)
        self._put(right, np.zeros(self._n))
        self._inner.apply(pc, right, y)
        right.destroy()
        alpha = np.linalg.solve(self._small, self._sum(self._columns.T @ y.getArray(readonly=1)) - given)
        y.setArray(y.getArray(readonly=1) - self._products @ alpha)
        self._put(y, alpha)

    def _take(self, vector: PETSc.Vec) -> NDArray[np.float64]:
        """Alpha's rows of a vector, on all ranks."""
        return self._sum(np.zeros(self._n) if self._here is None else np.array(vector.getArray(readonly=1)[self._here]))

    def _put(self, vector: PETSc.Vec, values: NDArray[np.float64]) -> None:
        if self._here is not None:
            vector.getArray()[self._here] = values

    def _sum(self, mine: NDArray[np.float64]) -> NDArray[np.float64]:
        total = np.empty_like(mine)
        self._comm.Allreduce(np.ascontiguousarray(mine), total, op=MPI.SUM)
        return total


def motion_scales(team: Team, systems: Sequence[LocalSystem]) -> dict[int, NDArray[np.float64]]:
    """Kappa = sum_s diag R_s^T M_s R_s of every camera whose set-up moves, (n_shifts,), by its number; collective."""
    mine = [(s.subdomain.camera, s.shift_block.diagonal()) for s in systems if s.subdomain.shifts is not None]
    found: dict[int, NDArray[np.float64]] = {}
    for camera, diagonal in team.gather_lists(mine):
        found[camera] = found.get(camera, 0.0) + diagonal
    return found
