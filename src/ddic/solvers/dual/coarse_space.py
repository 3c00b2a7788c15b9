"""The coarse space of the interface problem: low-energy modes of the subdomains, seen by the interface."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import linalg, sparse

from ddic.parallel.team import Team
from ddic.solvers.dual.local_dual import LocalDual
from ddic.solvers.exchange import Exchange
from ddic.solvers.parallel_entries import ParallelEntries
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
    """Z and the factorised coarse matrix Z^T S_tot Z, sparse and spread over ranks.

    PETSc options (prefix ``coarse_``): the coarse matrix is factorised by MUMPS (LDL^T, symmetric indefinite).
    """

    def __init__(self, team: Team, exchange: Exchange, locals_: Sequence[LocalDual],
                 assemblies: Sequence[sparse.csr_matrix], schurs: Sequence[SchurProduct],
                 columns: Sequence[tuple[NDArray[np.float64], int]]) -> None:
        """Assemble and factorise.

        assemblies: E_s, scaled; schurs: from X to S_s X; columns: of ``coarse_columns``, per owned subdomain.
        """
        comm = team.comm
        counts = [vectors.shape[1] for vectors, _ in columns]
        n_owned = sum(counts)
        first = sum(comm.allgather(n_owned)[: team.rank])
        starts = first + np.concatenate([[0], np.cumsum(counts)])[:-1].astype(np.int64)
        entries = ParallelEntries(comm, exchange.n_owned, n_owned)
        for assembly, (vectors, _), start in zip(assemblies, columns, starts, strict=True):
            touched = np.flatnonzero(np.diff(assembly.indptr))
            entries.add(exchange.ghosts[touched], start + np.arange(vectors.shape[1]), assembly[touched] @ vectors)
        self._z = entries.matrix()
        self._ksp = self._factorize(comm, self._products(comm, exchange, locals_, schurs, n_owned),
                                    first + np.arange(n_owned), columns)
        self._right, self._left = self._ksp.getOperators()[0].createVecs()

    @property
    def size(self) -> int:
        """Number of coarse vectors."""
        return int(self._z.getSize()[1])

    def correct(self, residual: PETSc.Vec, result: PETSc.Vec) -> None:
        """Add Z (Z^T S_tot Z)^-1 Z^T residual to ``result``."""
        self._z.multTranspose(residual, self._right)
        self._ksp.solve(self._right, self._left)
        self._z.multAdd(self._left, result, result)

    def destroy(self) -> None:
        """Free PETSc's objects."""
        matrix = self._ksp.getOperators()[0]
        for thing in (self._ksp, matrix, self._z, self._right, self._left):
            thing.destroy()

    def _products(self, comm: MPI.Comm, exchange: Exchange, locals_: Sequence[LocalDual],
                  schurs: Sequence[SchurProduct], n_owned: int) -> ParallelEntries:
        """Z^T S_tot Z as the sum over subdomains of products with the columns that touch their interface."""
        products = ParallelEntries(comm, n_owned, n_owned)
        touched, z_ghost = _rows_of(self._z, exchange.ghosts)
        for local, schur in zip(locals_, schurs, strict=True):
            z_local = (local.incidence.T @ z_ghost).tocsc()
            present = np.flatnonzero(np.diff(z_local.indptr))
            dense = z_local[:, present].toarray()
            products.add(touched[present], touched[present], dense.T @ schur(dense))
        return products

    @staticmethod
    def _factorize(comm: MPI.Comm, products: ParallelEntries, owned: NDArray[np.int64],
                   columns: Sequence[tuple[NDArray[np.float64], int]]) -> PETSc.KSP:
        matrix = products.matrix()
        diagonal = matrix.getDiagonal()
        size = diagonal.duplicate()
        diagonal.copy(size)
        size.abs()
        signs = np.concatenate([np.zeros(0), *(np.repeat([1.0, -1.0], [n, vectors.shape[1] - n])
                                               for vectors, n in columns)])
        diagonal.setArray(diagonal.getArray() + SHIFT * size.max()[1] * signs)
        matrix.setDiagonal(diagonal)
        diagonal.destroy()
        size.destroy()
        matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        ksp = configured_ksp(comm, COARSE)
        ksp.setOperators(matrix)
        ksp.setFromOptions()
        ksp.setUp()
        return ksp


SchurProduct = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""S_s X from X, both (n interface dofs, k)."""

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
