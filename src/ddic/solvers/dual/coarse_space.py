"""The coarse space of the interface problem: low-energy modes of the subdomains, seen by the interface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import linalg, sparse

from ddic.parallel.team import Team
from ddic.solvers.dual.exchange import Exchange
from ddic.solvers.dual.local_dual import LocalDual
from ddic.solvers.petsc_defaults import COARSE, configured_ksp

INDEPENDENT = 1e-8
"""Singular value, relative to the largest, below which a subdomain's coarse vectors count as dependent."""

SHIFT = 1e-13
"""Share of the largest diagonal entry added to (subtracted from) the coarse matrix's displacement (reaction)
diagonal. Coarse vectors of neighbours are dependent where they add up to a continuous field (exactly so for rigid
modes); such a combination is no interface vector at all, and the shift keeps the factorisation from breaking on it."""


def coarse_columns(modes: NDArray[np.float64], local: LocalDual) -> tuple[NDArray[np.float64], int]:
    """A subdomain's coarse vectors on its own interface dofs, from its modes (n_dofs, k).

    Displacement traces and reactions of the modes make separate vectors, (C_s phi, 0) and (0, eta Cbar_s Kbar_s phi),
    each set orthonormal. Returns (n interface dofs, n vectors) and how many of them are displacement vectors.
    """
    traces = local.trace @ modes
    n = local.n_displacement
    displacement, reaction = _independent(traces[:n]), _independent(traces[n:])
    return np.asarray(linalg.block_diag(displacement, reaction)), displacement.shape[1]


def _independent(columns: NDArray[np.float64]) -> NDArray[np.float64]:
    if columns.size == 0:
        return np.zeros((len(columns), 0))
    left, values, _ = linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, values > INDEPENDENT * values[0]])


class CoarseSpace:
    """Z, S_tot Z and the factorised coarse matrix Z^T S_tot Z, all sparse and spread over ranks.

    PETSc options (prefix ``coarse_``): the coarse matrix is factorised by MUMPS (LDL^T, symmetric indefinite).
    """

    def __init__(self, team: Team, exchange: Exchange, locals_: Sequence[LocalDual],
                 assemblies: Sequence[sparse.csr_matrix], schurs: Sequence[NDArray[np.float64]],
                 columns: Sequence[tuple[NDArray[np.float64], int]]) -> None:
        """Assemble and factorise.

        assemblies: E_s, scaled; schurs: S_s dense; columns: of ``coarse_columns``, per owned subdomain.
        """
        comm = team.comm
        counts = [vectors.shape[1] for vectors, _ in columns]
        n_owned = sum(counts)
        first = sum(comm.allgather(n_owned)[: team.rank])
        starts = first + np.concatenate([[0], np.cumsum(counts)])[:-1].astype(np.int64)
        rows = exchange.new_vector()
        sizes = (rows.getSizes(), (n_owned, PETSc.DETERMINE))
        rows.destroy()
        self._z = _assemble(comm, sizes, [
            _triplets(sparse.csr_matrix(e @ vectors), exchange.ghosts, np.arange(start, start + vectors.shape[1]))
            for e, (vectors, _), start in zip(assemblies, columns, starts, strict=True)
        ])
        touched, z_ghost = _rows_of(self._z, exchange.ghosts)
        images, products = [], []
        for local, schur in zip(locals_, schurs, strict=True):
            z_local = (local.incidence.T @ z_ghost).tocsc()
            present = np.flatnonzero(np.diff(z_local.indptr))
            dense = z_local[:, present].toarray()
            image = schur @ dense
            images.append(_triplets(sparse.csr_matrix(local.incidence @ image), exchange.ghosts, touched[present]))
            products.append(_triplets(sparse.csr_matrix(dense.T @ image), touched[present], touched[present]))
        self._image = _assemble(comm, sizes, images)
        signs = np.concatenate([np.zeros(0), *(np.repeat([1.0, -1.0], [n, vectors.shape[1] - n])
                                               for vectors, n in columns)])
        self._ksp = self._factorize(comm, (sizes[1], sizes[1]), products, first + np.arange(n_owned), signs)
        self._right, self._left = self._ksp.getOperators()[0].createVecs()

    @property
    def size(self) -> int:
        """Number of coarse vectors."""
        return int(self._z.getSize()[1])

    def correct(self, residual: PETSc.Vec, done: PETSc.Vec | None, result: PETSc.Vec) -> None:
        """Add Z (Z^T S Z)^-1 (Z^T residual - (S Z)^T done) to ``result``; ``done`` is a correction already made."""
        self._z.multTranspose(residual, self._right)
        if done is not None:
            self._image.multTranspose(done, self._left)
            self._right.axpy(-1.0, self._left)
        self._ksp.solve(self._right, self._left)
        self._z.multAdd(self._left, result, result)

    def destroy(self) -> None:
        """Free PETSc's objects."""
        matrix = self._ksp.getOperators()[0]
        for thing in (self._ksp, matrix, self._z, self._image, self._right, self._left):
            thing.destroy()

    @staticmethod
    def _factorize(comm: MPI.Comm, sizes: Sizes, products: Sequence[Triplets],
                   owned: NDArray[np.int64], signs: NDArray[np.float64]) -> PETSc.KSP:
        matrix = _assemble(comm, sizes, products)
        diagonal = matrix.getDiagonal()
        diagonal.abs()
        shift = SHIFT * diagonal.max()[1]
        diagonal.destroy()
        matrix.destroy()
        shifted = _assemble(comm, sizes, [*products, (owned, owned, shift * signs)])
        shifted.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        ksp = configured_ksp(comm, COARSE)
        ksp.setOperators(shifted)
        ksp.setFromOptions()
        ksp.setUp()
        return ksp


Triplets = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]
"""Global rows, global columns and values of matrix entries."""

Sizes = tuple[tuple[int, int], tuple[int, int]]
"""Local and global numbers of rows and of columns (global ones may be PETSc's DETERMINE)."""


def _triplets(matrix: sparse.csr_matrix, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> Triplets:
    entries = matrix.tocoo()
    return rows[entries.row], columns[entries.col], entries.data


def _assemble(comm: MPI.Comm, sizes: Sizes, parts: Sequence[Triplets]) -> PETSc.Mat:
    """A parallel sparse matrix from entries anywhere: each goes to the rank that owns its row; duplicates add up."""
    rows, columns = (np.concatenate([np.zeros(0, np.int64), *(part[k] for part in parts)]) for k in range(2))
    values = np.concatenate([np.zeros(0), *(part[2] for part in parts)])
    (n_rows, n_columns) = (local for local, _ in sizes)
    ends = np.cumsum(comm.allgather(n_rows))
    order = np.argsort(rows, kind="stable")
    cuts = np.searchsorted(rows[order], ends[:-1])
    received = comm.alltoall([(rows[p], columns[p], values[p]) for p in np.split(order, cuts)])
    first = int(ends[comm.Get_rank()]) - n_rows
    rows, columns, values = (np.concatenate([piece[k] for piece in received]) for k in range(3))
    shape = (n_rows, int(comm.allreduce(n_columns)))
    local = sparse.coo_matrix((values, (rows - first, columns)), shape=shape).tocsr()
    csr = (local.indptr.astype(PETSc.IntType), local.indices.astype(PETSc.IntType), local.data)
    return PETSc.Mat().createAIJ(((n_rows, PETSc.DETERMINE), (n_columns, PETSc.DETERMINE)), csr=csr, comm=comm)


def _rows_of(matrix: PETSc.Mat, rows: NDArray[np.int64]) -> tuple[NDArray[np.int64], sparse.csr_matrix]:
    """Rows of a parallel matrix that this rank asks for: the columns that occur, and the rows on these columns."""
    wanted = PETSc.IS().createGeneral(rows.astype(PETSc.IntType), comm=matrix.getComm())
    part = matrix.createSubMatrix(wanted)
    indptr, indices, values = part.getValuesCSR()
    touched, compressed = np.unique(indices, return_inverse=True)
    out = sparse.csr_matrix((np.array(values), compressed.reshape(-1), np.array(indptr)),
                            shape=(len(rows), len(touched)))
    part.destroy()
    wanted.destroy()
    return touched.astype(np.int64), out
