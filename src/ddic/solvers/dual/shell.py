"""What PETSc asks of the shell operators of the interface problem."""

from __future__ import annotations

from typing import Protocol

from petsc4py import PETSc


class Preconditioning(Protocol):
    """Context of a shell preconditioner."""

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """PETSc's callback for y = P x."""
        ...


class Multiplying(Protocol):
    """Context of a shell matrix."""

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """PETSc's callback for y = S x."""
        ...
