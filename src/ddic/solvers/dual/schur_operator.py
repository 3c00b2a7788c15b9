"""The dual Schur complement S_tot as a PETSc shell operator, Eq. 25-31 of [BP17]."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from petsc4py import PETSc

from ddic.solvers.dual.local_dual import LocalDual
from ddic.solvers.dual.shell import Multiplying
from ddic.solvers.exchange import Exchange


class DualSchurOperator:
    """Context of the shell matrix: S_tot v = sum_s G_s A_s^-1 G_s^T v - H_s v.

    The matrix is symmetric and quasi-definite; one local solve per subdomain and product.
    """

    def __init__(self, exchange: Exchange, locals_: Sequence[LocalDual]) -> None:
        self._exchange = exchange
        self._locals = locals_
        self.comm = exchange.comm

    def mult(self, _: PETSc.Mat | None, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """PETSc's callback for y = S_tot x."""
        v = self._exchange.to_ghosts(x)
        total = np.zeros_like(v)
        for local in self._locals:
            total += local.apply(v)
        self._exchange.add_to_owners(total, y)

    multTranspose = mult

    def as_matrix(self) -> PETSc.Mat:
        """S_tot as a shell matrix over all ranks."""
        return self.shell(self)

    def shell(self, context: Multiplying) -> PETSc.Mat:
        """A shell matrix with the rows and columns of S_tot over all ranks."""
        vector = self._exchange.new_vector()
        matrix = PETSc.Mat().createPython((vector.getSizes(), vector.getSizes()), context, comm=vector.getComm())
        matrix.setUp()
        vector.destroy()
        return matrix
