"""Who owns which number, and the neighbour exchange of values.

From the copies of an interface unknown comes one value, section 5.3.2 of [BP17].
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc

from ddic.arrays import Array, IntArray
from ddic.parallel.field import Field
from ddic.parallel.team import Team
from ddic.partition.subdomain import Interface, Subdomain, copies_of
from ddic.solvers.petsc import PetscStack, check_petsc_size, to_petsc_integers


class Exchange:
    """Numbers (interface rows, copies, unknowns) owned in contiguous ranges by ranks, with ghosts of neighbours.

    Only ranks that share a number exchange its value (PETSc's scatter).

    Parameters
    ----------
    team : Team
        All ranks; they make it together.
    n_owned : int
        How many numbers this rank owns; the ranges follow the order of the ranks.
    needed : sequence of (n,) arrays of int64
        Numbers that each owned subdomain takes part in.

    Attributes
    ----------
    ghosts : (n_ghosts,) array of int64
        All numbers that this rank takes part in, sorted.
    n_global : int
        How many numbers all ranks own.
    """

    def __init__(self, team: Team, n_owned: int, needed: Sequence[IntArray]) -> None:
        self.team = team
        self.n_owned = n_owned
        self.ghosts: IntArray = np.unique(np.concatenate([np.zeros(0, np.int64), *needed]))
        n_ghosts = len(self.ghosts)
        check_petsc_size(team.sum(n_owned), "unknowns of all ranks")
        numbers = to_petsc_integers(self.ghosts, "unknowns of all ranks")
        with PetscStack() as stack, PetscStack() as indices:
            self._owned = stack.keep(PETSc.Vec().createMPI((n_owned, PETSc.DETERMINE), comm=team.comm))
            self._ghost = stack.keep(PETSc.Vec().createSeq(n_ghosts, comm=PETSc.COMM_SELF))
            self.n_global = int(self._owned.getSize())
            source = indices.keep(PETSc.IS().createGeneral(numbers, comm=PETSc.COMM_SELF))
            target = indices.keep(PETSc.IS().createStride(n_ghosts, first=0, step=1, comm=PETSc.COMM_SELF))
            self._scatter = stack.keep(PETSc.Scatter().create(self._owned, source, self._ghost, target))
            self._objects = stack.pop_all()

    def destroy(self) -> None:
        """Free PETSc's objects."""
        self._objects.close()

    def create_vector(self) -> PETSc.Vec:
        """Create a zero vector of owned numbers over all ranks, the caller's to destroy."""
        vector = self._owned.duplicate()
        vector.set(0.0)
        return vector

    def fetch_ghosts(self, owned: PETSc.Vec) -> Array:
        """Fetch the values of all numbers that this rank takes part in, in the order of ``ghosts``; collective."""
        self._scatter.scatter(owned, self._ghost, addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
        return np.array(self._ghost.getArray(readonly=1))

    def add_to_owners(self, ghosts: Array, owned: PETSc.Vec) -> None:
        """Set a vector to the sum of what the ranks contribute, each in the order of ``ghosts``; collective."""
        self._ghost.setArray(ghosts)
        owned.set(0.0)
        self._scatter.scatter(self._ghost, owned, addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)

    def sum_over_ranks(self, ghosts: Array) -> Array:
        """Sum what the ranks contribute, in the order of ``ghosts``, and give each the sums of its own; collective."""
        with PetscStack() as stack:
            owned = stack.keep(self.create_vector())
            self.add_to_owners(ghosts, owned)
            return self.fetch_ghosts(owned)


def fetch_copies(team: Team, subdomains: Sequence[Subdomain], values: Sequence[tuple[Interface, Array]],
                 ) -> tuple[IntArray, Array]:
    """Fetch what all subdomains have at the copies of chains that owned subdomains take part in; collective.

    ``values`` are owned subdomains' interfaces, each with what it has at its unknowns. Returns the copies' numbers,
    sorted, and their values, both (n,).
    """
    with PetscStack() as stack:
        n_owned = sum(subdomain.n_owned_copies for subdomain in subdomains)
        exchange = stack.keep(Exchange(team, n_owned, [copies_of(interface) for interface, _ in values]))
        mine = np.zeros(len(exchange.ghosts))
        for interface, of_unknowns in values:
            own_copies = interface.first_copy + interface.position
            mine[np.searchsorted(exchange.ghosts, own_copies)] = of_unknowns
        return exchange.ghosts, exchange.sum_over_ranks(mine)


@dataclass(frozen=True)
class ContinuousField:
    """Unknowns with interface copies averaged, and the largest jump before that.

    Attributes
    ----------
    q : Field
        The unknowns, pixels.
    largest_jump : float
        Largest difference that the copies of an unknown make in a node's displacement, pixels.
    """

    q: Field
    largest_jump: float


def average_copies(q: Field) -> ContinuousField:
    """Average the copies of every interface unknown, pixels, section 5.3.2 of [BP17]; collective.

    The averages are equal, to the last bit, on all subdomains that share an unknown.
    """
    own = [(s.jumps, q_s[s.jumps.unknowns]) for s, q_s in zip(q.subdomains, q, strict=True)]
    numbers, copies = fetch_copies(q.team, q.subdomains, own)
    parts = []
    largest = 0.0
    for subdomain, q_s in zip(q.subdomains, q, strict=True):
        interface = subdomain.jumps
        mean, spread = _mean_and_spread(interface, numbers, copies)
        averaged = np.array(q_s)
        averaged[interface.unknowns] = mean
        parts.append(averaged)
        # By how many pixels an unknown of size one displaces the node that it displaces most.
        reach = np.asarray(abs(subdomain.kinematics.tangent).max(axis=0).todense()).ravel()
        largest = max(largest, float((spread * reach[interface.unknowns]).max(initial=0.0)))
    return ContinuousField(q.with_parts(parts), q.team.maximum(largest))


def _mean_and_spread(interface: Interface, numbers: IntArray, copies: Array) -> tuple[Array, Array]:
    """Mean, and largest less smallest, of the copies of each of a subdomain's interface unknowns."""
    values = copies[np.searchsorted(numbers, copies_of(interface))]
    if len(values) == 0:
        return values, values
    first = np.cumsum(interface.multiplicity) - interface.multiplicity
    mean = np.add.reduceat(values, first) / interface.multiplicity
    return mean, np.maximum.reduceat(values, first) - np.minimum.reduceat(values, first)
