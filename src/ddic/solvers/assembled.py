"""The linear step on the whole mesh by one sparse Cholesky spread over ranks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from ddic.errors import FactorizationError, on_all_ranks
from ddic.parallel.team import Team
from ddic.solvers.linear_step import Leave, StepResult
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.parallel_entries import ParallelEntries
from ddic.solvers.petsc_defaults import ASSEMBLED, configured_ksp
from ddic.solvers.singularity import lowest_eigenvalue_estimate
from ddic.solvers.whole_system import WholeSystem

ZERO_PIVOT = -10
"""MUMPS's INFOG(1) for a matrix that is numerically singular."""


class AssembledStep:
    """Solves Eq. 11 of [BP17] for all subdomains at once, by a factor of A.

    PETSc options (prefix ``assembled_``): Cholesky by MUMPS.
    """

    def __init__(self, team: Team, systems: Sequence[LocalSystem], smallest_eigenvalue: float) -> None:
        """Assemble and factorise; collective.

        systems: this rank's subdomains; smallest_eigenvalue: below it A counts as singular.
        Raises SingularSubdomainError and FactorizationError on all ranks.
        """
        self._whole = WholeSystem(team, systems)
        self._matrix = _operator(team.comm, self._whole)
        self._left, self._right = self._matrix.createVecs()
        self._ksp = configured_ksp(team.comm, ASSEMBLED)
        try:
            self._factorize(team.rank, smallest_eigenvalue)
        except BaseException:
            self.destroy()
            raise

    def solve(self, q: Sequence[NDArray[np.float64]], b: Sequence[NDArray[np.float64]],
              leave: Leave | None = None) -> StepResult:
        """Solve for dq_s; where copies of a node differ in q, q + dq is one field, as of the dual step."""
        mean = self._whole.mean_of_copies(q)
        self._whole.set_right_hand_side(self._right, q, b, mean)
        self._ksp.solve(self._right, self._left)
        return StepResult(self._whole.corrections(self._left, q, mean), 0, np.zeros(0), 0.0)

    def destroy(self) -> None:
        """Free PETSc's objects; must be called before the interpreter ends."""
        for thing in (self._ksp, self._matrix, self._left, self._right, self._whole):
            thing.destroy()

    def _factorize(self, seed: int, smallest_eigenvalue: float) -> None:
        # Not left to MUMPS, which says no more than that a pivot is zero.
        self._whole.refuse_unheld(self._matrix)
        self._ksp.setOperators(self._matrix)
        self._ksp.setFromOptions()
        self._ksp.setUp()
        factor = self._ksp.getPC().getFactorMatrix()
        self._refuse_want_of_memory(factor)
        self._left.setArray(np.random.default_rng(seed).standard_normal(self._left.getLocalSize()))
        # A factor that broke down at a zero pivot solves to infinity, hence counts as singular too.
        if not lowest_eigenvalue_estimate(factor, self._left) > smallest_eigenvalue:
            self._left.abs()
            raise self._whole.singular_at(self._left.max()[0])

    def _refuse_want_of_memory(self, factor: PETSc.Mat) -> None:
        if self._ksp.getPC().getFactorSolverType() != "mumps":
            return
        code = factor.getMumpsInfog(1)
        if code < 0 and code != ZERO_PIVOT:
            raise on_all_ranks(FactorizationError(
                f"MUMPS could not factorise the assembled operator (INFOG(1) = {code}, INFOG(2) = "
                f"{factor.getMumpsInfog(2)}), most often for want of memory; start more ranks or use "
                'solver.method = "dual"'))


def _operator(comm: MPI.Comm, whole: WholeSystem) -> PETSc.Mat:
    """A of Eq. 11: rows of Kbar are complete before they are squared."""
    rows, entries = (ParallelEntries(comm, whole.n_owned, whole.n_owned) for _ in range(2))
    for system, kbar, n in zip(whole.systems, whole.kbars, whole.numbers, strict=True):
        entries.add_sparse(n, n, system.hessian)
        rows.add_sparse(n, n, kbar)
    gap = rows.owned_rows()
    everything = np.arange(gap.shape[1])
    entries.add_sparse(everything, everything, whole.systems[0].eta * (gap.T @ gap))
    matrix = entries.matrix()
    matrix.setOption(PETSc.Mat.Option.SPD, True)
    return matrix
