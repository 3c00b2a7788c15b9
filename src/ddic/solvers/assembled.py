"""The linear step on the whole region by one sparse Cholesky spread over ranks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse

from ddic.errors import FactorizationError, as_collective
from ddic.parallel.team import Team
from ddic.solvers.linear_step import AllowedError, StepResult
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.parallel_entries import ParallelEntries
from ddic.solvers.petsc_defaults import ASSEMBLED, create_ksp
from ddic.solvers.petsc_stack import PetscStack
from ddic.solvers.singularity import bound_lowest_eigenvalue
from ddic.solvers.whole_system import WholeSystem

ZERO_PIVOT = -10
"""MUMPS's INFOG(1) for a matrix that is numerically singular."""


class AssembledStep:
    """Solves Eq. 11 of [BP17] for all subdomains at once, by a factor of A.

    PETSc options (prefix ``assembled_``): Cholesky by MUMPS.

    Parameters
    ----------
    team : Team
        All ranks; they make it together.
    systems : sequence of LocalSystem
        This rank's subdomains.
    smallest_eigenvalue : float
        Below it A counts as singular, grey levels squared per pixel squared.

    Raises
    ------
    SingularSubdomainError, FactorizationError
        On all ranks.
    """

    def __init__(self, team: Team, systems: Sequence[LocalSystem], smallest_eigenvalue: float) -> None:
        with PetscStack() as stack:
            self._whole = stack.keep(WholeSystem(team, systems))
            self._matrix = stack.keep(_assemble(team, self._whole))
            self._left = stack.keep(self._whole.create_vector())
            self._right = stack.keep(self._whole.create_vector())
            self._ksp = stack.keep(create_ksp(team.comm, ASSEMBLED))
            self._factorize(team.rank, smallest_eigenvalue)
            self._objects = stack.pop_all()

    def solve(self, q: Sequence[NDArray[np.float64]], b: Sequence[NDArray[np.float64]],
              allowed: AllowedError | None = None) -> StepResult:
        """Solve for dq_s; where copies of an unknown differ in q, q + dq is one field, as of the dual step.

        Parameters
        ----------
        q : sequence of (n_unknowns,) arrays
            q_s of each owned subdomain, pixels.
        b : sequence of (n_unknowns,) arrays
            Its b_s, grey levels squared per pixel.
        allowed : AllowedError, optional
            Does not matter: the step is direct.

        Returns
        -------
        StepResult
            Without an error.
        """
        mean = self._whole.average_copies(q)
        self._whole.set_right_hand_side(self._right, q, b, mean)
        self._ksp.solve(self._right, self._left)
        return StepResult(self._whole.find_corrections(self._left, q, mean), 0, np.zeros(0), 0.0)

    def forget(self) -> None:
        """Do nothing: no step teaches another."""

    def destroy(self) -> None:
        """Free PETSc's objects; must be called before the interpreter ends."""
        self._objects.close()

    def _factorize(self, seed: int, smallest_eigenvalue: float) -> None:
        """Factorise A and refuse it where it is singular."""
        # Not left to MUMPS, which says no more than that a pivot is zero.
        self._whole.check_diagonal(self._matrix)
        self._ksp.setOperators(self._matrix)
        self._ksp.setFromOptions()
        self._ksp.setUp()
        with PetscStack() as stack:
            factor = stack.keep(self._ksp.getPC().getFactorMatrix())
            self._check_memory(factor)
            self._left.setArray(np.random.default_rng(seed).standard_normal(self._left.getLocalSize()))
            lowest = bound_lowest_eigenvalue(factor, self._left)
        # A factor that broke down at a zero pivot solves to infinity, hence counts as singular too.
        if not lowest > smallest_eigenvalue:
            self._left.abs()
            raise self._whole.describe_singular(self._left.max()[0])

    def _check_memory(self, factor: PETSc.Mat) -> None:
        """Raise where MUMPS failed for another reason than a zero pivot."""
        if self._ksp.getPC().getFactorSolverType() != "mumps":
            return
        code = factor.getMumpsInfog(1)
        if code < 0 and code != ZERO_PIVOT:
            raise as_collective(FactorizationError(
                f"MUMPS could not factorise the assembled operator (INFOG(1) = {code}, INFOG(2) = "
                f"{factor.getMumpsInfog(2)}), most often for want of memory; start more ranks or use "
                'solver.method = "dual"'))


def _assemble(team: Team, whole: WholeSystem) -> PETSc.Mat:
    """Assemble A of Eq. 11: rows of Kbar are complete before they are squared."""
    rows = ParallelEntries(team, whole.n_owned, whole.n_owned)
    entries = ParallelEntries(team, whole.n_owned, whole.n_owned)
    for system, of_system, numbers in zip(whole.systems, whole.rows, whole.numbers, strict=True):
        entries.add_sparse(numbers, numbers, system.hessian)
        rows.add_sparse(numbers, numbers, of_system.assemble())
    kbar_rows = rows.sum_owned_rows()
    touched, places = np.unique(kbar_rows.indices, return_inverse=True)
    kbar_touched = sparse.csr_matrix((kbar_rows.data, places.reshape(-1), kbar_rows.indptr),
                                     shape=(kbar_rows.shape[0], len(touched)))
    columns = touched.astype(np.int64)
    entries.add_sparse(columns, columns, whole.systems[0].eta * (kbar_touched.T @ kbar_touched))
    matrix = entries.create_matrix()
    matrix.setOption(PETSc.Mat.Option.SPD, True)
    return matrix
