"""The local operator A_s = M_s + eta Kbar_s^T Kbar_s, factorised once and solved many times."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse

from ddic.errors import SingularSubdomainError
from ddic.solvers.petsc_defaults import LOCAL, configured_ksp
from ddic.solvers.singularity import lowest_eigenvalue_estimate, singular

_BLOCK_COLUMNS = 256
_BLOCK_BYTES = 2**24


class LocalOperator:
    """Sparse Cholesky of one symmetric positive definite matrix through PETSc.

    PETSc options (prefix ``local_``): ``-local_pc_factor_mat_solver_type`` cholmod (default), mumps, petsc.
    """

    def __init__(self, matrix: sparse.csr_matrix, *, smallest_eigenvalue: float, where: str) -> None:
        """Factorise.

        matrix: (n, n) symmetric; smallest_eigenvalue: below it the matrix counts as singular;
        where: what to call it in the error. Raises SingularSubdomainError.
        """
        # Not left to the factorisation, which writes lines of its own about a matrix that holds nothing.
        if not (matrix.diagonal() > 0).all():
            raise SingularSubdomainError(singular(where))
        self.n = int(matrix.shape[0])
        index = PETSc.IntType
        self._matrix = PETSc.Mat().createAIJ(
            matrix.shape, csr=(matrix.indptr.astype(index), matrix.indices.astype(index), matrix.data),
            comm=PETSc.COMM_SELF,
        )
        self._matrix.setOption(PETSc.Mat.Option.SPD, True)
        self._ksp = configured_ksp(PETSc.COMM_SELF, LOCAL)
        self._ksp.setOperators(self._matrix)
        self._ksp.setFromOptions()
        try:
            self._ksp.setUp()
        except PETSc.Error as error:
            raise SingularSubdomainError(singular(where)) from error
        self._factor = self._ksp.getPC().getFactorMatrix()
        self._left, self._right = self._matrix.createVecs()
        self._right.setArray(np.random.default_rng(0).standard_normal(self.n))
        if not lowest_eigenvalue_estimate(self._factor, self._right) > smallest_eigenvalue:
            raise SingularSubdomainError(singular(where))

    def solve(self, right: NDArray[np.float64]) -> NDArray[np.float64]:
        """Solve A x = right for one vector (n,)."""
        self._right.setArray(right)
        self._factor.solve(self._right, self._left)
        return np.array(self._left.getArray(readonly=1))

    @property
    def block(self) -> int:
        """Number of columns to solve for at a time: enough for speed, few enough that a block stays below 16 MiB."""
        return max(1, min(_BLOCK_COLUMNS, _BLOCK_BYTES // (8 * self.n)))

    def solve_many(self, right: NDArray[np.float64]) -> NDArray[np.float64]:
        """Solve A X = right for the columns of an array (n, k), a block at a time."""
        solution = np.empty((self.n, right.shape[1]), order="F")
        for begin in range(0, right.shape[1], self.block):
            columns = np.asfortranarray(right[:, begin: begin + self.block])
            # Whole columns in Fortran's order are contiguous: PETSc writes into the result itself.
            target = solution[:, begin: begin + self.block]
            b = PETSc.Mat().createDense(columns.shape, array=columns, comm=PETSc.COMM_SELF)
            x = PETSc.Mat().createDense(columns.shape, array=target, comm=PETSc.COMM_SELF)
            b.assemble()
            x.assemble()
            self._factor.matSolve(b, x)
            b.destroy()
            x.destroy()
        return solution

    def destroy(self) -> None:
        """Free the factor."""
        for thing in (self._factor, self._ksp, self._matrix, self._left, self._right):
            thing.destroy()
