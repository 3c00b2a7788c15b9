"""The linear step on the whole mesh by one sparse Cholesky spread over ranks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse

from ddic.errors import FactorizationError, SingularSubdomainError, on_all_ranks
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.solvers.exchange import Exchange
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.parallel_entries import ParallelEntries
from ddic.solvers.petsc_defaults import ASSEMBLED, configured_ksp
from ddic.solvers.singularity import lowest_eigenvalue_estimate, singular
from ddic.solvers.step import Leave, StepResult

ZERO_PIVOT = -10
"""MUMPS's INFOG(1) for a matrix that is numerically singular."""


class AssembledStep:
    """Solves Eq. 11 of [BP17] for all subdomains at once: A = sum_s R_s^T M_s R_s + eta Kbar^T Kbar.

    R_s takes a subdomain's dofs from those of the whole mesh. PETSc options (prefix ``assembled_``): Cholesky by MUMPS.
    """

    def __init__(self, team: Team, systems: Sequence[LocalSystem], smallest_eigenvalue: float) -> None:
        """Assemble and factorise; collective.

        systems: this rank's subdomains; smallest_eigenvalue: below it A counts as singular.
        Raises SingularSubdomainError and FactorizationError on all ranks.
        """
        self._team = team
        self._systems = systems
        numbers, n_owned = _numbers(team.comm, [s.subdomain for s in systems])
        self._exchange = Exchange(team.comm, n_owned, numbers)
        self._places = [np.searchsorted(self._exchange.ghosts, n) for n in numbers]
        self._shares = 1.0 / self._gathered([np.ones(len(n)) for n in numbers])
        self._kbars = [_unweighted(system) for system in systems]
        self._matrix = self._operator(team.comm, n_owned, numbers)
        self._left, self._right = self._matrix.createVecs()
        self._ksp = configured_ksp(team.comm, ASSEMBLED)
        try:
            self._factorize(smallest_eigenvalue)
        except BaseException:
            self.destroy()
            raise

    def solve(self, q: Sequence[NDArray[np.float64]], b: Sequence[NDArray[np.float64]],
              leave: Leave | None = None) -> StepResult:
        """Solve for dq_s; where copies of a node differ in q, q + dq is one field, as of the dual step.

        A (qbar + dqbar) = sum_s R_s^T (b_s + M_s q_s) with qbar the mean of the copies, solved for dqbar.
        """
        mean = self._shares * self._gathered(q)
        gap = self._gathered([kbar @ mean[at] for kbar, at in zip(self._kbars, self._places, strict=True)])
        right = [b_s + s.hessian @ (q_s - mean[at]) - s.eta * (kbar.T @ gap[at])
                 for s, kbar, b_s, q_s, at in zip(self._systems, self._kbars, b, q, self._places, strict=True)]
        self._exchange.add_to_owners(self._added(right), self._right)
        self._ksp.solve(self._right, self._left)
        dq = self._exchange.to_ghosts(self._left)
        return StepResult([mean[at] + dq[at] - q_s for q_s, at in zip(q, self._places, strict=True)],
                          0, np.zeros(0), 0.0)

    def destroy(self) -> None:
        """Free PETSc's objects; must be called before the interpreter ends."""
        for thing in (self._ksp, self._matrix, self._left, self._right, self._exchange):
            thing.destroy()

    def _added(self, values: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
        """Sum over this rank's subdomains, on all dofs that they have, in the order of the ghosts."""
        total = np.zeros(len(self._exchange.ghosts))
        for at, v in zip(self._places, values, strict=True):
            total[at] += v
        return total

    def _gathered(self, values: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
        """Sum over the subdomains of all ranks, on all dofs that this rank's subdomains have."""
        owned = self._exchange.new_vector()
        self._exchange.add_to_owners(self._added(values), owned)
        result = self._exchange.to_ghosts(owned)
        owned.destroy()
        return result

    def _operator(self, comm: MPI.Comm, n_owned: int, numbers: Sequence[NDArray[np.int64]]) -> PETSc.Mat:
        """A of Eq. 11: rows of Kbar are complete before they are squared."""
        rows, entries = ParallelEntries(comm, n_owned, n_owned), ParallelEntries(comm, n_owned, n_owned)
        for system, kbar, n in zip(self._systems, self._kbars, numbers, strict=True):
            entries.add_sparse(n, n, system.hessian)
            rows.add_sparse(n, n, kbar)
        kbar = rows.owned_rows()
        everything = np.arange(kbar.shape[1])
        entries.add_sparse(everything, everything, self._systems[0].eta * (kbar.T @ kbar))
        matrix = entries.matrix()
        matrix.setOption(PETSc.Mat.Option.SPD, True)
        return matrix

    def _factorize(self, smallest_eigenvalue: float) -> None:
        diagonal = self._matrix.getDiagonal()
        where, lowest = diagonal.min()
        diagonal.destroy()
        # Not left to MUMPS, which says no more than that a pivot is zero.
        if not lowest > 0:
            raise self._singular_at(where)
        self._ksp.setOperators(self._matrix)
        self._ksp.setFromOptions()
        self._ksp.setUp()
        factor = self._ksp.getPC().getFactorMatrix()
        self._refuse_want_of_memory(factor)
        self._left.setArray(np.random.default_rng(self._team.rank).standard_normal(self._left.getLocalSize()))
        # A factor that broke down at a zero pivot solves to infinity, hence counts as singular too.
        if not lowest_eigenvalue_estimate(factor, self._left) > smallest_eigenvalue:
            self._left.abs()
            raise self._singular_at(self._left.max()[0])

    def _refuse_want_of_memory(self, factor: PETSc.Mat) -> None:
        if self._ksp.getPC().getFactorSolverType() != "mumps":
            return
        code = factor.getMumpsInfog(1)
        if code < 0 and code != ZERO_PIVOT:
            raise on_all_ranks(FactorizationError(
                f"MUMPS could not factorise the assembled operator (INFOG(1) = {code}, INFOG(2) = "
                f"{factor.getMumpsInfog(2)}), most often for want of memory; start more ranks or use "
                'solver.method = "dual"'))

    def _singular_at(self, number: int) -> SingularSubdomainError:
        """The error that names the node of a dof, from its number."""
        nodes = [system.subdomain.mesh.nodes[int(local) // system.subdomain.mesh.dim]
                 for system, at in zip(self._systems, self._places, strict=True)
                 for local in np.flatnonzero(self._exchange.ghosts[at] == number)]
        x, y = self._team.gather_lists(nodes)[0][:2]
        return on_all_ranks(SingularSubdomainError(singular(f"the region around column {x:.0f}, row {y:.0f}")))


def _numbers(comm: MPI.Comm, subdomains: Sequence[Subdomain]) -> tuple[list[NDArray[np.int64]], int]:
    """Number the dofs rank by rank, so that little but the interface is sent.

    A dof belongs to its lowest subdomain. Returns each subdomain's numbers (n_dofs,) and how many this rank owns.
    """
    dofs = [s.dofs for s in subdomains]
    mine = [_owned(s) for s in subdomains]
    n_owned = sum(int(m.sum()) for m in mine)
    first = sum(comm.allgather(n_owned)[: comm.Get_rank()])
    n_dofs = comm.allreduce(n_owned)
    share = len(range(comm.Get_rank(), n_dofs, comm.Get_size()))
    by_mesh = Exchange(comm, share, dofs)
    given = np.zeros(len(by_mesh.ghosts))
    given[np.searchsorted(by_mesh.ghosts, np.concatenate([d[m] for d, m in zip(dofs, mine, strict=True)]))] = (
        first + np.arange(n_owned))
    numbers = by_mesh.new_vector()
    by_mesh.add_to_owners(given, numbers)
    everybodys = by_mesh.to_ghosts(numbers).astype(np.int64)
    numbers.destroy()
    result = [everybodys[np.searchsorted(by_mesh.ghosts, d)] for d in dofs]
    by_mesh.destroy()
    return result, n_owned


def _owned(subdomain: Subdomain) -> NDArray[np.bool_]:
    owned = np.ones(len(subdomain.dofs), dtype=bool)
    owned[subdomain.displacement.dofs[subdomain.displacement.position > 0]] = False
    return owned


def _unweighted(system: LocalSystem) -> sparse.csr_matrix:
    """Kbar_s whose rows add up over subdomains to Kbar.

    The coupled subdomains minimise (1/m) |sum_s (Kbar_s q_s)_i|^2 at a dof of m of them: consistent weights sqrt(m)
    make that the row of the whole mesh, the paper's weight 1 leaves the row of the whole mesh over sqrt(m).
    """
    if system.controlled_stiffness is None:
        return sparse.csr_matrix(system.hessian.shape)
    return (sparse.diags(1.0 / np.sqrt(system.subdomain.dof_multiplicity)) @ system.controlled_stiffness).tocsr()
