"""Two-level preconditioner: the scaled block inverse and a coarse space, combined as A-DEF2."""

from __future__ import annotations

from petsc4py import PETSc

from ddic.solvers.dual.coarse_space import CoarseSpace
from ddic.solvers.dual.preconditioner import DualPreconditioner
from ddic.solvers.dual.schur_operator import DualSchurOperator
from ddic.solvers.petsc_stack import PetscStack


class TwoLevelPreconditioner:
    """Context of PETSc's shell preconditioner: y = (I - Q S) P r + Q r, Q = Z (Z^T S Z)^-1 Z^T (A-DEF2).

    One application is one of P, one of S and one coarse solve. S Z, which would save the product, takes more memory
    than all of the rest, and as much time.

    Parameters
    ----------
    operator : DualSchurOperator
        S.
    one_level : DualPreconditioner
        P.
    coarse : CoarseSpace
        Q.
    """

    def __init__(self, operator: DualSchurOperator, one_level: DualPreconditioner, coarse: CoarseSpace) -> None:
        self._operator = operator
        self._one_level = one_level
        self._coarse = coarse

    def apply(self, pc: PETSc.PC | None, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply y = P x + Q (x - S P x): PETSc's callback.

        Parameters
        ----------
        pc : PETSc.PC or None
            Passed on.
        x : PETSc.Vec
            Residuals.
        y : PETSc.Vec
            Overwritten.
        """
        self._one_level.apply(pc, x, y)
        with PetscStack() as stack:
            left = stack.keep(x.duplicate())
            self._operator.mult(None, y, left)
            left.aypx(-1.0, x)
            self._coarse.correct(left, y)
