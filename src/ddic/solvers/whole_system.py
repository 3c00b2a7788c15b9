"""M + eta Kbar^T Kbar, Eq. 11 of [BP17], of the whole region: sums over the subdomains' parts, never formed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from petsc4py import PETSc
from scipy import sparse

from ddic.arrays import Array, IntArray
from ddic.errors import SingularSubdomainError, as_collective
from ddic.functionals.scale_rows import scale_rows
from ddic.parallel.field import Field
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.solvers.exchange import Exchange
from ddic.solvers.local_operator import describe_singular
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.petsc import PetscStack


class WholeSystem:
    """A = sum_s R_s^T M_s R_s + eta Kbar^T Kbar with Kbar = sum_s R_s^T Kbar_s R_s.

    R_s takes a subdomain's unknowns (of the field, and of its camera's motion) from those of the whole problem, which
    are numbered rank by rank. Vectors of values "here" are on all unknowns that this rank's subdomains have, (n_here,).

    Parameters
    ----------
    team : Team
        All ranks; they make it together.
    systems : sequence of LocalSystem
        This rank's subdomains.

    Attributes
    ----------
    numbers : list of (n_unknowns,) arrays of int64
        Numbers of each subdomain's unknowns, rank by rank.
    n_owned : int
        How many of them this rank owns.
    exchange : Exchange
        Of values by these numbers.
    rows : list of EquilibriumRows
        Kbar_s whose rows add up to those of Kbar.
    """

    def __init__(self, team: Team, systems: Sequence[LocalSystem]) -> None:
        self.systems = systems
        self._team = team
        with PetscStack() as stack:
            self._subdomains = [system.subdomain for system in systems]
            self.numbers, self.n_owned = _number_by_rank(team, self._subdomains)
            self.exchange = stack.keep(Exchange(team, self.n_owned, self.numbers))
            self._places = [np.searchsorted(self.exchange.ghosts, n) for n in self.numbers]
            self.rows = [EquilibriumRows.of(system) for system in systems]
            self._multiplicity = self.sum_over_subdomains([np.ones(len(n)) for n in self.numbers])
            self._objects = stack.pop_all()

    def average_copies(self, q: Field) -> Field:
        """Average what subdomains say of each unknown; collective."""
        return self.restrict(self.sum_over_subdomains(q) / self._multiplicity)

    def restrict(self, here: Array) -> Field:
        """Give each owned subdomain the values of its unknowns from those here."""
        return Field(self._team, self._subdomains, [here[places] for places in self._places])

    def add_up(self, values: Sequence[Array]) -> Array:
        """Add up values of each owned subdomain, (n_unknowns,), over this rank's subdomains: sums here, (n_here,)."""
        total = np.zeros(len(self.exchange.ghosts))
        for places, values_s in zip(self._places, values, strict=True):
            total[places] += values_s
        return total

    def sum_over_subdomains(self, values: Sequence[Array]) -> Array:
        """Add up values of each owned subdomain over the subdomains of all ranks: sums here, (n_here,); collective."""
        return self.exchange.sum_over_ranks(self.add_up(values))

    def mult(self, _: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Multiply y = A x: PETSc's callback, where this is the context of a shell matrix."""
        x_here = self.restrict(self.exchange.fetch_ghosts(x))
        gap = self._find_gap(x_here)
        products = []
        for system, rows, x_s, gap_s in zip(self.systems, self.rows, x_here, gap, strict=True):
            of_gap = system.eta * rows.multiply_transposed(gap_s)
            products.append(system.hessian @ x_s + of_gap)
        self.exchange.add_to_owners(self.add_up(products), y)

    def getDiagonal(self, _: PETSc.Mat, diagonal: PETSc.Vec) -> None:
        """Set a vector to A's diagonal, rows of Kbar on interfaces squared one by one, as is enough to precondition."""
        of_systems = [system.hessian.diagonal() + system.eta * rows.sum_squares()
                      for system, rows in zip(self.systems, self.rows, strict=True)]
        self.exchange.add_to_owners(self.add_up(of_systems), diagonal)

    def set_right_hand_side(self, right: PETSc.Vec, q: Field, b: Field, q_mean: Field) -> None:
        """Set a vector to sum_s R_s^T (b_s + M_s (q_s - qbar_s)) - eta Kbar^T Kbar qbar; collective.

        ``q_mean`` is qbar, the one field that takes the place of copies that differ.
        """
        gap = self._find_gap(q_mean)
        parts = []
        for system, rows, b_s, change_s, gap_s in zip(self.systems, self.rows, b, q - q_mean, gap, strict=True):
            of_gap = system.eta * rows.multiply_transposed(gap_s)
            parts.append(b_s + system.hessian @ change_s - of_gap)
        self.exchange.add_to_owners(self.add_up(parts), right)

    def find_correction(self, solution: PETSc.Vec, q: Field, q_mean: Field) -> Field:
        """Find dq by which q + dq is qbar of ``set_right_hand_side`` plus the solution everywhere; collective."""
        return q_mean + self.restrict(self.exchange.fetch_ghosts(solution)) - q

    def check_diagonal(self, operator: PETSc.Mat) -> None:
        """Check that the diagonal of A, or of what gives it, is positive: something holds every unknown; collective.

        Raises SingularSubdomainError on all ranks.
        """
        with PetscStack() as stack:
            diagonal = stack.keep(self.create_vector())
            operator.getDiagonal(diagonal)
            number, lowest = diagonal.min()
        if not lowest > 0:
            raise self.describe_singular(number)

    def describe_singular(self, number: int) -> SingularSubdomainError:
        """Describe that nothing holds an unknown, by the node that it displaces most; collective.

        ``number`` is that of the unknown, rank by rank; SingularSubdomainError is to be raised on all ranks.
        """
        nodes = [_find_node(subdomain, int(unknown))
                 for subdomain, numbers in zip(self._subdomains, self.numbers, strict=True)
                 for unknown in np.flatnonzero(numbers == number)]
        x, y = self._team.gather_lists(nodes)[0][:2]
        place = f"the region around column {x:.0f}, row {y:.0f}"
        return as_collective(SingularSubdomainError(describe_singular(place)))

    def create_vector(self) -> PETSc.Vec:
        """Create a zero vector of owned unknowns over all ranks, the caller's to destroy."""
        return self.exchange.create_vector()

    def destroy(self, _: PETSc.Mat | None = None) -> None:
        """Free PETSc's objects; PETSc calls it too, when the shell matrix goes whose context this is."""
        self._objects.close()

    def _find_gap(self, x: Field) -> Field:
        """Kbar x, rows of interfaces complete."""
        if all(system.stiffness is None for system in self.systems):
            return Field.zero(self._team, self._subdomains)
        forces = [rows.multiply(x_s) for rows, x_s in zip(self.rows, x, strict=True)]
        return self.restrict(self.sum_over_subdomains(forces))


def _number_by_rank(team: Team, subdomains: Sequence[Subdomain]) -> tuple[list[IntArray], int]:
    """Number the unknowns rank by rank, so that little but the interface is sent.

    An unknown belongs to its lowest subdomain. Returns each subdomain's numbers (n_unknowns,) and how many this rank
    owns.
    """
    numbers = [s.numbers for s in subdomains]
    is_owned = [s.owned for s in subdomains]
    n_owned = sum(int(owned.sum()) for owned in is_owned)
    first = team.offset(n_owned)
    # Of the numbers in the whole problem every rank owns an equal share, only to pass the new ones on.
    n_share = len(range(team.rank, team.sum(n_owned), team.size))
    with PetscStack() as stack:
        exchange = stack.keep(Exchange(team, n_share, numbers))
        owned_numbers = np.concatenate([n[owned] for n, owned in zip(numbers, is_owned, strict=True)])
        given = np.zeros(len(exchange.ghosts))
        given[np.searchsorted(exchange.ghosts, owned_numbers)] = first + np.arange(n_owned)
        everybodys = exchange.sum_over_ranks(given).astype(np.int64)
        return [everybodys[np.searchsorted(exchange.ghosts, n)] for n in numbers], n_owned


def _find_node(subdomain: Subdomain, unknown: int) -> Array:
    """The node that an unknown of a subdomain displaces most, (dim,), pixels; the first for a camera's motion."""
    nodes: Array = subdomain.mesh.nodes
    if unknown >= subdomain.n_field:
        return np.asarray(nodes[0])
    column = subdomain.kinematics.tangent[:, [unknown]].toarray().reshape(nodes.shape)
    return np.asarray(nodes[int(np.linalg.norm(column, axis=1).argmax())])


@dataclass(frozen=True)
class EquilibriumRows:
    """Kbar_s without the weights of interface rows, so that its rows add up over subdomains to Kbar.

    The coupled subdomains minimise (1/m) |sum_s (Kbar_s q_s)_i|^2 at an unknown of m of them: consistent weights
    sqrt(m) make that the row of the whole region, the paper's weight 1 leaves that row over sqrt(m).
    Products take the system's own stiffness: a matrix of other rows would be as large as M.

    Attributes
    ----------
    stiffness : (n_field, n_unknowns) csr_matrix
        diag(w) T^T K T.
    factors : (n_field,) array
        Of its rows, no unit.
    """

    stiffness: sparse.csr_matrix
    factors: Array

    @classmethod
    def of(cls, system: LocalSystem) -> EquilibriumRows:
        """Take those of a system, whose field has Kbar_s; without regularization, all are empty."""
        subdomain = system.subdomain
        factors = 1.0 / np.sqrt(subdomain.multiplicity)
        if system.projection is not None:
            factors = factors * system.projection
        if system.stiffness is None:
            return cls(sparse.csr_matrix((subdomain.n_field, subdomain.n_unknowns)), np.ones(subdomain.n_field))
        return cls(system.stiffness, factors)

    def multiply(self, x: Array) -> Array:
        """Compute Kbar_s x, x in pixels; 0 for a camera's motion: it displaces no matter, so is in no equilibrium."""
        product = np.zeros(len(x))
        np.multiply(self.factors, self.stiffness @ x, out=product[:len(self.factors)])
        return product

    def multiply_transposed(self, gap: Array) -> Array:
        """Compute Kbar_s^T times a value of each unknown, forces, (n_unknowns,), without those of a camera's motion."""
        return np.asarray(self._transposed @ (self.factors * gap[:len(self.factors)]))

    def sum_squares(self) -> Array:
        """Sum the squares of each unknown's column: the diagonal of Kbar_s^T Kbar_s, (n_unknowns,)."""
        return np.asarray(self.stiffness.power(2).T @ self.factors**2)

    def assemble(self) -> sparse.csr_matrix:
        """Form the square matrix, for who needs more than its products; rows of a camera's motion are zero."""
        n_field, n_unknowns = self.stiffness.shape
        no_equilibrium = sparse.csr_matrix((n_unknowns - n_field, n_unknowns))
        return sparse.vstack([scale_rows(self.stiffness, self.factors), no_equilibrium]).tocsr()

    @cached_property
    def _transposed(self) -> sparse.csc_matrix:
        """The same numbers; making the matrix anew takes longer than its product with a vector."""
        return self.stiffness.T
