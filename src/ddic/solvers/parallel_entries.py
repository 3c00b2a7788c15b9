"""A parallel sparse matrix in the making."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse

from ddic.parallel.team import Team

_CHUNK = 2**23
"""Entries collected before duplicates are added up: what neighbours add to the same place would else fill memory. A
larger number adds up less often and takes more memory."""


class ParallelEntries:
    """A parallel sparse matrix in the making, from blocks anywhere in it; overlapping blocks add up.

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
        self._sum = sparse.csr_matrix((sum(self._local_rows), sum(self._local_columns)))
        self._blocks: list[sparse.coo_matrix] = []
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
        self._keep(block.ravel(), np.repeat(rows, len(columns)), np.tile(columns, len(rows)))

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
        self._keep(entries.data, rows[entries.row], columns[entries.col])

    def sum_owned_rows(self) -> sparse.csr_matrix:
        """Sum what all ranks added to the rows that this rank owns; collective.

        Returns
        -------
        (n_rows, all columns) csr_matrix
            This rank's rows.
        """
        self._add_up()
        ends = np.cumsum(self._local_rows)
        starts = ends - self._local_rows
        pieces = [self._sum[start:end] for start, end in zip(starts, ends, strict=True)]
        rank = self._team.rank
        # What stays is not sent: a message has at most 2 GiB.
        received = self._team.all_to_all([None if r == rank else piece for r, piece in enumerate(pieces)])
        local = pieces[rank]
        for piece in received:
            if piece is not None:
                local = local + piece
        local = local.tocsr()
        local.sort_indices()
        return local

    def create_matrix(self) -> PETSc.Mat:
        """Create the matrix over all ranks; collective.

        Returns
        -------
        PETSc.Mat
            The caller's to destroy.
        """
        local = self.sum_owned_rows()
        csr = (local.indptr.astype(PETSc.IntType), local.indices.astype(PETSc.IntType), local.data)
        rank = self._team.rank
        row_sizes = (self._local_rows[rank], sum(self._local_rows))
        column_sizes = (self._local_columns[rank], sum(self._local_columns))
        return PETSc.Mat().createAIJ((row_sizes, column_sizes), csr=csr, comm=self._team.comm)

    def _keep(self, values: NDArray[np.float64], rows: NDArray[np.int64], columns: NDArray[np.int64]) -> None:
        """Keep entries until they are added up."""
        places = (rows.astype(np.int32), columns.astype(np.int32))
        self._blocks.append(sparse.coo_matrix((values, places), shape=self._sum.shape))
        self._n_waiting += len(values)
        if self._n_waiting > _CHUNK:
            self._add_up()

    def _add_up(self) -> None:
        """Add the blocks kept to the sum."""
        if self._blocks:
            values = np.concatenate([block.data for block in self._blocks])
            rows = np.concatenate([block.row for block in self._blocks])
            columns = np.concatenate([block.col for block in self._blocks])
            self._blocks.clear()
            self._sum = self._sum + sparse.coo_matrix((values, (rows, columns)), shape=self._sum.shape).tocsr()
        self._n_waiting = 0
