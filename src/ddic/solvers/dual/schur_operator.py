"""The dual Schur complement S_tot as a PETSc shell operator, Eq. 25-31 of [BP17]."""

from __future__ import annotations

from collections.abc import Sequence

from petsc4py import PETSc

from ddic.parallel.team import Team
from ddic.solvers.dual.local_dual import LocalDual
from ddic.solvers.dual.rank_dual import RankDual
from ddic.solvers.dual.shell import Multiplying
from ddic.solvers.exchange import Exchange


class DualSchurOperator:
    """Context of the shell matrix: S_tot v = sum_s G_s A_s^-1 G_s^T v - H_s v, Eq. 26 of [BP17].

    The matrix is symmetric and quasi-definite; one local solve per subdomain and product.

    Parameters
    ----------
    exchange : Exchange
        Of interface rows.
    local_duals : sequence of LocalDual
        This rank's subdomains.

    Attributes
    ----------
    of_rank : RankDual
        All of them side by side.
    """

    def __init__(self, exchange: Exchange, local_duals: Sequence[LocalDual]) -> None:
        self._exchange = exchange
        self.of_rank = RankDual(local_duals)

    @property
    def team(self) -> Team:
        """The ranks that the interface is spread over."""
        return self._exchange.team

    def mult(self, _: PETSc.Mat | None, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Multiply by S_tot: PETSc's callback.

        Parameters
        ----------
        _ : PETSc.Mat or None
            Does not matter.
        x : PETSc.Vec
            Multipliers v.
        y : PETSc.Vec
            Overwritten by S_tot v.
        """
        v = self._exchange.fetch_ghosts(x)
        self._exchange.add_to_owners(self.of_rank.apply(v), y)

    multTranspose = mult

    def create_vector(self) -> PETSc.Vec:
        """Create a zero vector of interface rows over all ranks.

        Returns
        -------
        PETSc.Vec
            The caller's to destroy.
        """
        return self._exchange.create_vector()

    def create_matrix(self, context: Multiplying | None = None) -> PETSc.Mat:
        """Create a shell matrix with the rows and columns of S_tot over all ranks.

        Parameters
        ----------
        context : Multiplying, optional
            What multiplies; S_tot itself by default.

        Returns
        -------
        PETSc.Mat
            The caller's to destroy.
        """
        size = (self._exchange.n_owned, self._exchange.n_global)
        matrix = PETSc.Mat().createPython((size, size), context or self, comm=self.team.comm)
        matrix.setUp()
        return matrix
