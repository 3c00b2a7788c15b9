"""A parallel sparse matrix in the making."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse

_CHUNK = 2**23
"""Entries collected before duplicates are added up: what neighbours add to the same place would else fill memory."""


class ParallelEntries:
    """A parallel sparse matrix in the making, from blocks anywhere in it; overlapping blocks add up."""

    def __init__(self, comm: MPI.Comm, n_rows: int, n_columns: int) -> None:
        """n_rows, n_columns: those that this rank owns."""
        self._comm = comm
        self._local = [comm.allgather(n) for n in (n_rows, n_columns)]
        shape = tuple(sum(local) for local in self._local)
        self._sum = sparse.csr_matrix(shape)
        self._blocks: list[sparse.coo_matrix] = []
        self._waiting = 0

    def add(self, rows: NDArray[np.int64], columns: NDArray[np.int64], block: NDArray[np.float64]) -> None:
        """Add a block (n, k) at global rows (n,) and columns (k,)."""
        self._keep(block.ravel(), np.repeat(rows, len(columns)), np.tile(columns, len(rows)))

    def add_sparse(self, rows: NDArray[np.int64], columns: NDArray[np.int64], matrix: sparse.csr_matrix) -> None:
        """Add a sparse matrix (n, k) at global rows (n,) and columns (k,)."""
        entries = matrix.tocoo()
        self._keep(entries.data, rows[entries.row], columns[entries.col])

    def owned_rows(self) -> sparse.csr_matrix:
        """The rows that this rank owns, (n rows, all columns), from what all ranks added; collective."""
        self._add_up()
        ends = np.cumsum(self._local[0])
        starts = ends - self._local[0]
        pieces = [self._sum[a:b] for a, b in zip(starts, ends, strict=True)]
        rank = self._comm.Get_rank()
        # What stays is not sent: a message has at most 2 GiB.
        received = self._comm.alltoall([None if r == rank else piece for r, piece in enumerate(pieces)])
        others = (piece for r, piece in enumerate(received) if r != rank)
        local = sum(others, start=pieces[rank]).tocsr()
        local.sort_indices()
        return local

    def matrix(self) -> PETSc.Mat:
        """The matrix over all ranks; collective."""
        local = self.owned_rows()
        csr = (local.indptr.astype(PETSc.IntType), local.indices.astype(PETSc.IntType), local.data)
        rank = self._comm.Get_rank()
        sizes = tuple((of[rank], sum(of)) for of in self._local)
        return PETSc.Mat().createAIJ(sizes, csr=csr, comm=self._comm)

    def _keep(self, values: NDArray[np.float64], rows: NDArray[np.int64], columns: NDArray[np.int64]) -> None:
        index = (rows.astype(np.int32), columns.astype(np.int32))
        self._blocks.append(sparse.coo_matrix((values, index), shape=self._sum.shape))
        self._waiting += len(values)
        if self._waiting > _CHUNK:
            self._add_up()

    def _add_up(self) -> None:
        if self._blocks:
            values = np.concatenate([b.data for b in self._blocks])
            rows, columns = (np.concatenate([getattr(b, name) for b in self._blocks]) for name in ("row", "col"))
            self._blocks.clear()
            self._sum = self._sum + sparse.coo_matrix((values, (rows, columns)), shape=self._sum.shape).tocsr()
        self._waiting = 0
