"""Who owns which number, the neighbour exchange of values, and matrices whose rows ranks make for one another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from petsc4py import PETSc
from scipy import sparse

from ddic.arrays import Array, IntArray
from ddic.parallel.field import Field
from ddic.parallel.team import Team
from ddic.partition.subdomain import Interface, Subdomain, copies_of
from ddic.solvers.petsc import PetscOwner, PetscStack, check_petsc_size, to_petsc_integers


class _Multiplying(Protocol):
    """Context of a shell matrix."""

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Multiply y = A x: PETSc's callback."""


class Exchange(PetscOwner):
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

    def create_vector(self) -> PETSc.Vec:
        """Create a zero vector of owned numbers over all ranks, the caller's to destroy."""
        vector = self._owned.duplicate()
        vector.set(0.0)
        return vector

    def create_matrix(self, context: _Multiplying) -> PETSc.Mat:
        """Create a shell matrix on owned numbers over all ranks, the caller's to destroy."""
        size = (self.n_owned, self.n_global)
        matrix = PETSc.Mat().createPython((size, size), context, comm=self.team.comm)
        matrix.setUp()
        return matrix

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


_CHUNK = 2**23
"""Entries collected before duplicates are added up: what neighbours add to the same place would else fill memory. A
larger number adds up less often and takes more memory."""


@dataclass(frozen=True)
class _SomeRows:
    """Some rows of a large sparse matrix: their numbers in it, and what they hold; entries of one place add up."""

    numbers: IntArray
    entries: sparse.csr_matrix

    def cut(self, start: int, end: int) -> _SomeRows:
        """Cut out the rows from ``start`` to before ``end``, numbers in the whole matrix; numbers are sorted here."""
        first, last = np.searchsorted(self.numbers, (start, end))
        return _SomeRows(self.numbers[first:last], self.entries[first:last])


class ParallelEntries:
    """A parallel sparse matrix in the making, from blocks anywhere in it; overlapping blocks add up.

    Each rank holds the rows that it has added to, whoever owns them.

    Parameters
    ----------
    team : Team
        All ranks; they make it together.
    n_rows, n_columns : int
        How many this rank owns.
    """

    def __init__(self, team: Team, n_rows: int, n_columns: int) -> None:
        self._team = team
        self._local_rows = team.gather_lists([n_rows])
        self._local_columns = team.gather_lists([n_columns])
        self._n_columns = sum(self._local_columns)
        self._blocks: list[_SomeRows] = []
        self._n_waiting = 0

    def add(self, rows: IntArray, columns: IntArray, block: Array) -> None:
        """Add a dense block, (n, k), at its rows, (n,), and columns, (k,), of the whole matrix."""
        n, k = block.shape
        # Zeros of a block are entries too.
        entries = (block.ravel(), np.tile(np.arange(k), n), k * np.arange(n + 1))
        self.add_sparse(rows, columns, sparse.csr_matrix(entries, shape=(n, k)))

    def add_sparse(self, rows: IntArray, columns: IntArray, matrix: sparse.csr_matrix) -> None:
        """Add a sparse block, (n, k), at its rows, (n,), and columns, (k,), of the whole matrix."""
        entries = (matrix.data, columns[matrix.indices], matrix.indptr)
        self._blocks.append(_SomeRows(rows, sparse.csr_matrix(entries, shape=(len(rows), self._n_columns))))
        self._n_waiting += matrix.nnz
        if self._n_waiting > _CHUNK:
            self._blocks = [self._add_up(self._blocks)]
            self._n_waiting = 0

    def sum_owned_rows(self) -> sparse.csr_matrix:
        """Sum what all ranks added to the rows that this rank owns, (n_rows, all columns); collective."""
        added = self._add_up(self._blocks)
        self._blocks = []
        ends = np.cumsum(self._local_rows)
        starts = ends - self._local_rows
        by_owner = {rank: added.cut(start, end) for rank, (start, end) in enumerate(zip(starts, ends, strict=True))}
        rank = self._team.rank
        # What stays is not sent: a message has at most 2 GiB.
        own = by_owner.pop(rank)
        received = self._team.exchange({owner: rows for owner, rows in by_owner.items() if len(rows.numbers)})
        total = self._add_up([own, *received.values()])
        n_entries = np.zeros(self._local_rows[rank], np.int64)
        n_entries[total.numbers - starts[rank]] = np.diff(total.entries.indptr)
        row_starts = np.concatenate([[0], np.cumsum(n_entries)])
        local = sparse.csr_matrix((total.entries.data, total.entries.indices, row_starts),
                                  shape=(len(n_entries), self._n_columns))
        local.sort_indices()
        return local

    def create_matrix(self, symmetric_blocks: int = 1) -> PETSc.Mat:
        """Create the matrix over all ranks, the caller's to destroy; collective. Too large, FactorizationError.

        With ``symmetric_blocks`` of some size it is a symmetric one, which keeps the upper half of its blocks: with
        blocks of three a product takes a quarter of the time.
        """
        local = self.sum_owned_rows()
        rank = self._team.rank
        row_sizes = (self._local_rows[rank], sum(self._local_rows))
        column_sizes = (self._local_columns[rank], self._n_columns)
        check_petsc_size(max(row_sizes[1], self._n_columns), "rows of a matrix")
        create = PETSc.Mat().createAIJ
        if symmetric_blocks > 1:
            create = PETSc.Mat().createSBAIJ
            local = _keep_upper_blocks(local, sum(self._local_rows[:rank]), symmetric_blocks)
        csr = (to_petsc_integers(local.indptr, "entries of a rank's rows"),
               to_petsc_integers(local.indices, "columns of a matrix"), local.data)
        return create((row_sizes, column_sizes), bsize=symmetric_blocks, csr=csr, comm=self._team.comm)

    def _add_up(self, blocks: Sequence[_SomeRows]) -> _SomeRows:
        """The rows that blocks add up to, sorted."""
        none: IntArray = np.zeros(0, np.int64)
        numbers = np.unique(np.concatenate([none, *(block.numbers for block in blocks)]))
        n_entries = np.concatenate([none, *(np.diff(block.entries.indptr) for block in blocks)])
        rows = np.concatenate([none, *(np.searchsorted(numbers, block.numbers) for block in blocks)])
        columns = np.concatenate([none, *(block.entries.indices for block in blocks)])
        values = np.concatenate([np.zeros(0), *(block.entries.data for block in blocks)])
        entries = (values, (np.repeat(rows, n_entries), columns))
        return _SomeRows(numbers, sparse.coo_matrix(entries, shape=(len(numbers), self._n_columns)).tocsr())


def _keep_upper_blocks(rows: sparse.csr_matrix, first: int, size: int) -> sparse.bsr_matrix:
    """The blocks on and above the diagonal of some rows of a matrix, of which the first one is given."""
    blocks = rows.tobsr((size, size))
    blocks.sort_indices()
    of_blocks = first // size + np.repeat(np.arange(len(blocks.indptr) - 1), np.diff(blocks.indptr))
    kept = blocks.indices >= of_blocks
    up_to = np.concatenate([[0], np.cumsum(kept)])[blocks.indptr]
    return sparse.bsr_matrix((blocks.data[kept], blocks.indices[kept], up_to), shape=rows.shape)


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
        mean, spread = average_chains(interface, numbers, copies)
        averaged = np.array(q_s)
        averaged[interface.unknowns] = mean
        parts.append(averaged)
        # By how many pixels an unknown of size one displaces the node that it displaces most.
        reach = np.asarray(abs(subdomain.kinematics.tangent).max(axis=0).todense()).ravel()
        largest = max(largest, float((spread * reach[interface.unknowns]).max(initial=0.0)))
    return ContinuousField(q.with_parts(parts), q.team.maximum(largest))


def average_chains(interface: Interface, numbers: IntArray, copies: Array) -> tuple[Array, Array]:
    """Average what ``fetch_copies`` found at each of a subdomain's interface unknowns; also largest less smallest."""
    values = copies[np.searchsorted(numbers, copies_of(interface))]
    if len(values) == 0:
        return values, values
    first = np.cumsum(interface.multiplicity) - interface.multiplicity
    mean = np.add.reduceat(values, first) / interface.multiplicity
    return mean, np.maximum.reduceat(values, first) - np.minimum.reduceat(values, first)
