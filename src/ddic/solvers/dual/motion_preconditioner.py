"""The motion of near-field set-ups in the interface problem: eliminated exactly by the preconditioner."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from ddic.parallel.team import Team
from ddic.solvers.dual.schur_operator import DualSchurOperator
from ddic.solvers.dual.shell import Preconditioning
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.petsc_stack import PetscStack


class MotionPreconditioner:
    """Context of PETSc's shell preconditioner for [[S, B], [B^T, -D]] (Lambda, alpha), from P for S alone.

    alpha = (B^T P B + D)^-1 (B^T P r - r_alpha), Lambda = P (r - B alpha): exact where P = S^-1. The rows of alpha are
    the last ones, all on one rank; P takes and gives zeros there.

    Parameters
    ----------
    operator : DualSchurOperator
        Is applied to alpha's columns here, by all ranks together.
    inner : Preconditioning
        P, likewise.
    n_motion : int
        Number of unknowns alpha of all set-ups.
    """

    def __init__(self, operator: DualSchurOperator, inner: Preconditioning, n_motion: int) -> None:
        self._team = operator.team
        self._inner = inner
        self._n = n_motion
        columns, products, block = [], [], []
        with PetscStack() as stack:
            unit, column, solved, self._right = (stack.keep(operator.create_vector()) for _ in range(4))
            self._here = _find_last_rows(unit, n_motion)
            for k in range(n_motion):
                unit.set(0.0)
                self._put(unit, np.eye(n_motion)[k])
                operator.mult(None, unit, column)
                block.append(-self._take(column))
                self._put(column, np.zeros(n_motion))
                inner.apply(None, column, solved)
                columns.append(np.array(column.getArray()))
                products.append(np.array(solved.getArray()))
            self._columns = np.stack(columns, axis=1)
            self._products = np.stack(products, axis=1)
            d = np.stack(block, axis=1)
            self._small = self._team.sum(self._columns.T @ self._products) + d
            self._objects = stack.pop_all()

    def apply(self, pc: PETSc.PC | None, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply the preconditioner: PETSc's callback.

        Parameters
        ----------
        pc : PETSc.PC or None
            Passed on.
        x : PETSc.Vec
            r, r_alpha.
        y : PETSc.Vec
            Overwritten by Lambda, alpha.
        """
        given = self._take(x)
        x.copy(self._right)
        self._put(self._right, np.zeros(self._n))
        self._inner.apply(pc, self._right, y)
        projected = self._team.sum(self._columns.T @ y.getArray(readonly=1))
        alpha = np.linalg.solve(self._small, projected - given)
        y.setArray(y.getArray(readonly=1) - self._products @ alpha)
        self._put(y, alpha)

    def destroy(self, _: PETSc.PC | None = None) -> None:
        """Free PETSc's objects; PETSc calls it too, when the preconditioner goes whose context this is.

        Parameters
        ----------
        _ : PETSc.PC, optional
            Does not matter.
        """
        self._objects.close()

    def _take(self, vector: PETSc.Vec) -> NDArray[np.float64]:
        """Alpha's rows of a vector, on all ranks; collective."""
        mine = np.zeros(self._n)
        if self._here is not None:
            mine[:] = vector.getArray(readonly=1)[self._here]
        return self._team.sum(mine)

    def _put(self, vector: PETSc.Vec, values: NDArray[np.float64]) -> None:
        """Overwrite alpha's rows of a vector."""
        if self._here is not None:
            vector.getArray()[self._here] = values


def _find_last_rows(vector: PETSc.Vec, n: int) -> slice | None:
    """Where this rank holds the last n rows of a vector; None where another rank does."""
    first, end = vector.getOwnershipRange()
    begin = vector.getSize() - n
    return slice(begin - first, end - first) if end > begin else None


def sum_motion_scales(team: Team, systems: Sequence[LocalSystem]) -> dict[int, NDArray[np.float64]]:
    """Sum kappa = sum_s diag R_s^T M_s R_s of every camera whose set-up moves; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    systems : sequence of LocalSystem
        This rank's subdomains.

    Returns
    -------
    dict of (n_motion,) array
        By the camera's number, grey levels squared per pixel squared.
    """
    mine = [(system.subdomain.camera, system.motion_block.diagonal())
            for system in systems if system.subdomain.motion is not None]
    scales: dict[int, NDArray[np.float64]] = {}
    for camera, diagonal in team.gather_lists(mine):
        scales[camera] = scales.get(camera, 0.0) + diagonal
    return scales
