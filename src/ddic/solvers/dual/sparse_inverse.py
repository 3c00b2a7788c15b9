"""S_s^-1 of a large subdomain by one sparse factorisation, S_s never formed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse

from ddic.errors import SingularSubdomainError
from ddic.solvers.dual.local_dual import LocalDual
from ddic.solvers.petsc_defaults import INVERSE, configured_ksp


class SparseInverse:
    """S_s^-1 through [[A_s, -T_s^T], [-T_s, D_s]] (y, x) = (0, -r), whose x is S_s^-1 r.

    The first row gives y = A_s^-1 T_s^T x, the second then S_s x = r. With A_s eliminated what is left is -S_s, so
    that by Sylvester's law the matrix has as many negative eigenvalues as -S_s: one for each displacement dof of the
    interface, none for a reaction. That inertia is checked, as Cholesky checks the blocks of the dense inverse.

    PETSc options (prefix ``inverse_``): factorised by MUMPS (LDL^T); another package must tell the inertia too.
    """

    def __init__(self, matrix: sparse.csr_matrix, local: LocalDual) -> None:
        """Factorise.

        matrix: A_s, (n_dofs, n_dofs); local: the subdomain's T_s and D_s. Raises SingularSubdomainError.
        """
        self._n_dofs = matrix.shape[0]
        self._matrix = _saddle_point(matrix, local)
        self._ksp = configured_ksp(PETSc.COMM_SELF, INVERSE)
        self._ksp.setOperators(self._matrix)
        self._ksp.setFromOptions()
        self._factor = PETSc.Mat()
        self._left, self._right = self._matrix.createVecs()
        self._right.set(0.0)
        try:
            self._factorize(local.n_displacement)
        except SingularSubdomainError:
            self.destroy()
            raise

    def apply(self, r: NDArray[np.float64]) -> NDArray[np.float64]:
        """S_s^-1 r on the subdomain's own interface dofs, (n interface dofs,)."""
        self._right.getArray()[self._n_dofs:] = -r
        self._factor.solve(self._right, self._left)
        return np.array(self._left.getArray(readonly=1)[self._n_dofs:])

    def destroy(self) -> None:
        """Free the factor."""
        for thing in (self._factor, self._ksp, self._matrix, self._left, self._right):
            thing.destroy()

    def _factorize(self, n_negative: int) -> None:
        # A failure here is one of memory, hence PETSc's own error: MUMPS goes on past null pivots and counts them.
        self._ksp.setUp()
        self._factor = self._ksp.getPC().getFactorMatrix()
        if self._factor.getInertia()[:2] != (n_negative, 0):
            raise SingularSubdomainError(SINGULAR_INTERFACE)


SINGULAR_INTERFACE = ("the interface problem of a subdomain is singular to rounding; use larger subdomains, or a "
                      "shorter regularization.cut_off_wavelength")


def _saddle_point(matrix: sparse.csr_matrix, local: LocalDual) -> PETSc.Mat:
    """Upper triangle of [[A_s, -T_s^T], [-T_s, D_s]] as PETSc's symmetric matrix."""
    n = len(local.compliance)
    # Displacement dofs have zeros in D_s, which must be stored: PETSc wants all diagonal entries.
    corner = sparse.csr_matrix((local.compliance, (np.arange(n), np.arange(n))), shape=(n, n))
    upper = sparse.bmat([[sparse.triu(matrix, format="csr"), -local.trace.T], [None, corner]], format="csr")
    upper.sort_indices()
    index = PETSc.IntType
    return PETSc.Mat().createSBAIJ(
        upper.shape, 1, csr=(upper.indptr.astype(index), upper.indices.astype(index), upper.data),
        comm=PETSc.COMM_SELF)
