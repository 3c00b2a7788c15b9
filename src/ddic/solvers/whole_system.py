"""Eq. 11 of [BP17] for the whole mesh, from the subdomains' parts: sums over subdomains, A never formed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse

from ddic.errors import SingularSubdomainError, on_all_ranks
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.solvers.exchange import Exchange
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.singularity import singular


class WholeSystem:
    """A = sum_s R_s^T M_s R_s + eta Kbar^T Kbar with Kbar = sum_s R_s^T Kbar_s R_s.

    R_s takes a subdomain's unknowns (displacements, and the motion of its camera) from those of the whole problem,
    which are numbered rank by rank; vectors of values "here" are on all that this rank's subdomains have.
    """

    def __init__(self, team: Team, systems: Sequence[LocalSystem]) -> None:
        """Number the dofs and set up the exchange; systems: this rank's subdomains. Collective."""
        self._team = team
        self.systems = systems
        self.numbers, self.n_owned = _numbers(team.comm, [s.subdomain for s in systems])
        self.exchange = Exchange(team.comm, self.n_owned, self.numbers)
        self._places = [np.searchsorted(self.exchange.ghosts, n) for n in self.numbers]
        self.kbars = [_unweighted(system) for system in systems]
        self._multiplicity = self.gathered([np.ones(len(n)) for n in self.numbers])

    def mean_of_copies(self, values: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
        """Mean of what subdomains say (n_dofs,) of each dof, here; collective."""
        return np.asarray(self.gathered(values) / self._multiplicity)

    def of_subdomains(self, here: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Values of each owned subdomain's dofs, from values here."""
        return [here[at] for at in self._places]

    def added(self, values: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
        """Sum over this rank's subdomains, here."""
        total = np.zeros(len(self.exchange.ghosts))
        for at, v in zip(self._places, values, strict=True):
            total[at] += v
        return total

    def gathered(self, values: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
        """Sum over the subdomains of all ranks, here; collective."""
        owned = self.exchange.new_vector()
        self.exchange.add_to_owners(self.added(values), owned)
        result = self.exchange.to_ghosts(owned)
        owned.destroy()
        return result

    def apply(self, here: NDArray[np.float64]) -> NDArray[np.float64]:
        """Part of this rank in A x, to be added up by the owners; collective."""
        x = self.of_subdomains(here)
        gap = self._gap(x)
        return self.added([s.hessian @ x_s + s.eta * (kbar.T @ g)
                           for s, kbar, x_s, g in zip(self.systems, self.kbars, x, gap, strict=True)])

    def set_right_hand_side(self, right: PETSc.Vec, q: Sequence[NDArray[np.float64]], b: Sequence[NDArray[np.float64]],
                            mean: NDArray[np.float64]) -> None:
        """Let ``right`` be sum_s R_s^T (b_s + M_s (q_s - qbar_s)) - eta Kbar^T Kbar qbar; collective.

        mean: qbar, here, the one field that takes the place of copies that differ.
        """
        q_mean = self.of_subdomains(mean)
        gap = self._gap(q_mean)
        self.exchange.add_to_owners(self.added(
            [b_s + s.hessian @ (q_s - m) - s.eta * (kbar.T @ g) for s, kbar, b_s, q_s, m, g
             in zip(self.systems, self.kbars, b, q, q_mean, gap, strict=True)]), right)

    def corrections(self, solution: PETSc.Vec, q: Sequence[NDArray[np.float64]], mean: NDArray[np.float64],
                    ) -> list[NDArray[np.float64]]:
        """dq_s of each owned subdomain, by which q + dq is ``mean`` (here) plus the solution everywhere; collective."""
        found = self.of_subdomains(mean + self.exchange.to_ghosts(solution))
        return [new - q_s for new, q_s in zip(found, q, strict=True)]

    def refuse_unheld(self, operator: PETSc.Mat) -> None:
        """Raise SingularSubdomainError on all ranks where the diagonal of A is not positive; collective.

        operator: A, or what gives its diagonal.
        """
        diagonal = self.new_vector()
        operator.getDiagonal(diagonal)
        where, lowest = diagonal.min()
        diagonal.destroy()
        if not lowest > 0:
            raise self.singular_at(where)

    def singular_at(self, number: int) -> SingularSubdomainError:
        """The error that names the node of a dof, from its number; collective."""
        # A camera's motion that nothing holds is said to be where its first subdomain begins.
        nodes = [system.subdomain.nodes[int(local) // system.subdomain.mesh.dim % len(system.subdomain.nodes)]
                 for system, numbers in zip(self.systems, self.numbers, strict=True)
                 for local in np.flatnonzero(numbers == number)]
        x, y = self._team.gather_lists(nodes)[0][:2]
        return on_all_ranks(SingularSubdomainError(singular(f"the region around column {x:.0f}, row {y:.0f}")))

    def new_vector(self) -> PETSc.Vec:
        """A zero vector of owned dofs over all ranks."""
        return self.exchange.new_vector()

    def destroy(self) -> None:
        """Free PETSc's objects."""
        self.exchange.destroy()

    def _gap(self, x: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
        """Kbar x on each owned subdomain's dofs, rows of interfaces complete."""
        if all(s.controlled_stiffness is None for s in self.systems):
            return [np.zeros(len(x_s)) for x_s in x]
        return self.of_subdomains(self.gathered([kbar @ x_s for kbar, x_s in zip(self.kbars, x, strict=True)]))


def _numbers(comm: MPI.Comm, subdomains: Sequence[Subdomain]) -> tuple[list[NDArray[np.int64]], int]:
    """Number the dofs rank by rank, so that little but the interface is sent.

    A dof belongs to its lowest subdomain. Returns each subdomain's numbers (n_dofs,) and how many this rank owns.
    """
    dofs = [s.unknowns for s in subdomains]
    mine = [s.owned_unknowns for s in subdomains]
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


def _unweighted(system: LocalSystem) -> sparse.csr_matrix:
    """Kbar_s whose rows add up over subdomains to Kbar.

    The coupled subdomains minimise (1/m) |sum_s (Kbar_s q_s)_i|^2 at a dof of m of them: consistent weights sqrt(m)
    make that the row of the whole mesh, the paper's weight 1 leaves the row of the whole mesh over sqrt(m).
    """
    n_unknowns = system.hessian.shape[0]
    if system.controlled_stiffness is None:
        return sparse.csr_matrix((n_unknowns, n_unknowns))
    kbar = sparse.diags(1.0 / np.sqrt(system.subdomain.dof_multiplicity)) @ system.controlled_stiffness
    # A row for every unknown: a camera's motion is no displacement of matter, hence in no equilibrium.
    return sparse.vstack([kbar, sparse.csr_matrix((n_unknowns - kbar.shape[0], n_unknowns))]).tocsr()
