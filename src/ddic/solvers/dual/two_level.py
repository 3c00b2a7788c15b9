"""Two-level preconditioner: the scaled block inverse and a coarse space, combined as A-DEF2."""

from __future__ import annotations

from petsc4py import PETSc

from ddic.solvers.dual.coarse_space import CoarseSpace
from ddic.solvers.dual.preconditioner import DualPreconditioner


class TwoLevelPreconditioner:
    """Context of PETSc's shell preconditioner: y = (I - Q S) P r + Q r, Q = Z (Z^T S Z)^-1 Z^T (A-DEF2).

    One application is one of P and one coarse solve; S is not applied, for S Z is kept.
    """

    def __init__(self, one_level: DualPreconditioner, coarse: CoarseSpace) -> None:
        self._one_level = one_level
        self._coarse = coarse

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """PETSc's callback for y = (P - Q S P + Q) x."""
        self._one_level.apply(pc, x, y)
        done = y.copy()
        self._coarse.correct(x, done, y)
        done.destroy()
