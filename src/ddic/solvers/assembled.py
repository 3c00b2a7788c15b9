"""The linear step on the whole region by one sparse Cholesky spread over ranks.

A parallel sparse matrix in the making.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse

from ddic.arrays import Array, IntArray
from ddic.errors import FactorizationError, as_collective
from ddic.parallel.field import Field
from ddic.parallel.team import Team
from ddic.solvers.linear_step import AllowedError, StepResult
from ddic.solvers.local_operator import bound_lowest_eigenvalue
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.petsc import ASSEMBLED, PetscStack, check_petsc_size, create_ksp, to_petsc_integers
from ddic.solvers.whole_system import WholeSystem

_CHUNK = 2**23
"""Entries collected before duplicates are added up: what neighbours add to the same place would else fill memory. A
larger number adds up less often and takes more memory."""


@dataclass(frozen=True)
class SomeRows:
    """Some rows of a large sparse matrix.

    Attributes
    ----------
    numbers : (n,) array of int64
        Of the rows in the whole matrix, sorted.
    entries : (n, all columns) csr_matrix
        These rows.
    """

    numbers: IntArray
    entries: sparse.csr_matrix

    def cut(self, start: int, end: int) -> SomeRows:
        """Cut out the rows from ``start`` to before ``end``, numbers in the whole matrix."""
        first, last = np.searchsorted(self.numbers, (start, end))
        return SomeRows(self.numbers[first:last], self.entries[first:last])


@dataclass(frozen=True)
class _Block:
    """Entries of some rows, of which several may be in one place; ``places`` says which of the rows is an entry's."""

    rows: IntArray
    places: NDArray[np.integer[Any]]
    columns: NDArray[np.integer[Any]]
    values: Array


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
        self._blocks: list[_Block] = []
        self._n_waiting = 0

    def add(self, rows: IntArray, columns: IntArray, block: Array) -> None:
        """Add a dense block, (n, k), at its rows, (n,), and columns, (k,), of the whole matrix."""
        places = np.repeat(np.arange(len(rows)), len(columns))
        self._keep(_Block(rows, places, np.tile(columns, len(rows)), block.ravel()))

    def add_sparse(self, rows: IntArray, columns: IntArray, matrix: sparse.csr_matrix) -> None:
        """Add a sparse block, (n, k), at its rows, (n,), and columns, (k,), of the whole matrix."""
        entries = matrix.tocoo()
        self._keep(_Block(rows, entries.row, columns[entries.col], entries.data))

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
        total = self._add_up([_block_of(rows) for rows in (own, *received.values())])
        n_entries = np.zeros(self._local_rows[rank], np.int64)
        n_entries[total.numbers - starts[rank]] = np.diff(total.entries.indptr)
        row_starts = np.concatenate([[0], np.cumsum(n_entries)])
        local = sparse.csr_matrix((total.entries.data, total.entries.indices, row_starts),
                                  shape=(len(n_entries), self._n_columns))
        local.sort_indices()
        return local

    def create_matrix(self) -> PETSc.Mat:
        """Create the matrix over all ranks, the caller's to destroy; collective.

        Raises FactorizationError where it is too large for PETSc's integers.
        """
        local = self.sum_owned_rows()
        rank = self._team.rank
        row_sizes = (self._local_rows[rank], sum(self._local_rows))
        column_sizes = (self._local_columns[rank], self._n_columns)
        check_petsc_size(max(row_sizes[1], self._n_columns), "rows of a matrix")
        csr = (to_petsc_integers(local.indptr, "entries of a rank's rows"),
               to_petsc_integers(local.indices, "columns of a matrix"), local.data)
        return PETSc.Mat().createAIJ((row_sizes, column_sizes), csr=csr, comm=self._team.comm)

    def _keep(self, block: _Block) -> None:
        """Keep entries until they are added up."""
        self._blocks.append(block)
        self._n_waiting += len(block.values)
        if self._n_waiting > _CHUNK:
            self._blocks = [_block_of(self._add_up(self._blocks))]
            self._n_waiting = 0

    def _add_up(self, blocks: Sequence[_Block]) -> SomeRows:
        """The rows that blocks add up to."""
        none: IntArray = np.zeros(0, np.int64)
        numbers = np.unique(np.concatenate([none, *(block.rows for block in blocks)]))
        places = np.concatenate([none, *(np.searchsorted(numbers, block.rows)[block.places] for block in blocks)])
        columns = np.concatenate([none, *(block.columns for block in blocks)])
        values = np.concatenate([np.zeros(0), *(block.values for block in blocks)])
        shape = (len(numbers), self._n_columns)
        return SomeRows(numbers, sparse.coo_matrix((values, (places, columns)), shape=shape).tocsr())


def _block_of(rows: SomeRows) -> _Block:
    """Rows as a block that can be added to others."""
    entries = rows.entries.tocoo()
    return _Block(rows.numbers, entries.row, entries.col, entries.data)


ZERO_PIVOT = -10
"""MUMPS's INFOG(1) for a matrix that is numerically singular."""


class AssembledStep:
    """Solves Eq. 11 of [BP17] for all subdomains at once, by a factor of A.

    PETSc options (prefix ``assembled_``): Cholesky by MUMPS. Making it raises SingularSubdomainError or
    FactorizationError on all ranks.

    Parameters
    ----------
    team : Team
        All ranks; they make it together.
    systems : sequence of LocalSystem
        This rank's subdomains.
    smallest_eigenvalue : float
        Below it A counts as singular, grey levels squared per pixel squared.
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

    def solve(self, q: Field, b: Field, allowed: AllowedError | None = None) -> StepResult:
        """Solve for dq; where copies of an unknown differ in q, q + dq is one field, as of the dual step."""
        q_mean = self._whole.average_copies(q)
        self._whole.set_right_hand_side(self._right, q, b, q_mean)
        self._ksp.solve(self._right, self._left)
        return StepResult(self._whole.find_correction(self._left, q, q_mean))

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
    """Assemble A of Eq. 11 of [BP17]: rows of Kbar are complete before they are squared."""
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
