"""A parallel sparse matrix in the making."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse

from ddic.parallel.team import Team
from ddic.solvers.petsc_integers import check_petsc_size, to_petsc_integers

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

    numbers: NDArray[np.int64]
    entries: sparse.csr_matrix

    def cut(self, start: int, end: int) -> SomeRows:
        """Cut out the rows from ``start`` to before ``end``.

        Parameters
        ----------
        start, end : int
            Numbers in the whole matrix.

        Returns
        -------
        SomeRows
            Those of these rows that lie between.
        """
        first, last = np.searchsorted(self.numbers, (start, end))
        return SomeRows(self.numbers[first:last], self.entries[first:last])


@dataclass(frozen=True)
class _Block:
    """Entries of some rows, of which several may be in one place; ``places`` says which of the rows is an entry's."""

    rows: NDArray[np.int64]
    places: NDArray[np.integer[Any]]
    columns: NDArray[np.integer[Any]]
    values: NDArray[np.float64]


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

    def add(self, rows: NDArray[np.int64], columns: NDArray[np.int64], block: NDArray[np.float64]) -> None:
        """Add a dense block.

        Parameters
        ----------
        rows : (n,) array of int64
            Its rows in the whole matrix.
        columns : (k,) array of int64
            Its columns in the whole matrix.
        block : (n, k) array
            Its entries.
        """
        places = np.repeat(np.arange(len(rows)), len(columns))
        self._keep(_Block(rows, places, np.tile(columns, len(rows)), block.ravel()))

    def add_sparse(self, rows: NDArray[np.int64], columns: NDArray[np.int64], matrix: sparse.csr_matrix) -> None:
        """Add a sparse block.

        Parameters
        ----------
        rows : (n,) array of int64
            Its rows in the whole matrix.
        columns : (k,) array of int64
            Its columns in the whole matrix.
        matrix : (n, k) csr_matrix
            Its entries.
        """
        entries = matrix.tocoo()
        self._keep(_Block(rows, entries.row, columns[entries.col], entries.data))

    def sum_owned_rows(self) -> sparse.csr_matrix:
        """Sum what all ranks added to the rows that this rank owns; collective.

        Returns
        -------
        (n_rows, all columns) csr_matrix
            This rank's rows.
        """
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
        """Create the matrix over all ranks; collective.

        Returns
        -------
        PETSc.Mat
            The caller's to destroy.

        Raises
        ------
        FactorizationError
            Where it is too large for PETSc's integers.
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
        none: NDArray[np.int64] = np.zeros(0, np.int64)
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
