"""Two-level preconditioner: the scaled block inverse and a coarse space, combined as A-DEF2."""

from __future__ import annotations

from petsc4py import PETSc

from ddic.solvers.dual.coarse_space import CoarseSpace
from ddic.solvers.dual.preconditioner import DualPreconditioner
from ddic.solvers.dual.schur_operator import DualSchurOperator


class TwoLevelPreconditioner:
    """Context of PETSc's shell preconditioner: y = (I - Q S) P r + Q r, Q = Z (Z^T S Z)^-1 Z^T (A-DEF2).

    One application is one of P, one of S and one coarse solve. S Z, which would save the product, takes more memory
    than all of the rest, and as much time.
    """

    def __init__(self, operator: DualSchurOperator, one_level: DualPreconditioner, coarse: CoarseSpace) -> None:
        self._operator = operator
        self._one_level = one_level
        self._coarse = coarse

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """PETSc's callback for y = P x + Q (x - S P x)."""
        self._one_level.apply(pc, x, y)
        left = x.duplicate()
        self._operator.mult(None, y, left)
        left.aypx(-1.0, x)
        self._coarse.correct(left, y)
        left.destroy()
