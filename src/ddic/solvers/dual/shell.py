"""What PETSc asks of the shell operators of the interface problem."""

from __future__ import annotations

from typing import Protocol

from petsc4py import PETSc


class Preconditioning(Protocol):
    """Context of a shell preconditioner."""

    def apply(self, pc: PETSc.PC | None, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply y = P x: PETSc's callback.

        Parameters
        ----------
        pc : PETSc.PC or None
            The preconditioner whose context this is.
        x : PETSc.Vec
            Residuals.
        y : PETSc.Vec
            Overwritten by P x.
        """
        ...


class Multiplying(Protocol):
    """Context of a shell matrix."""

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Multiply y = S x: PETSc's callback.

        Parameters
        ----------
        matrix : PETSc.Mat
            The matrix whose context this is.
        x : PETSc.Vec
            Multipliers.
        y : PETSc.Vec
            Overwritten by S x.
        """
        ...
