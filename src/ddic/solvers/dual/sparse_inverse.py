"""S_s^-1 of a large subdomain by one sparse factorisation, S_s never formed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse

from ddic.errors import SingularSubdomainError
from ddic.solvers.dual.local_dual import LocalDual
from ddic.solvers.petsc_defaults import INVERSE, create_ksp
from ddic.solvers.petsc_integers import to_petsc_integers
from ddic.solvers.petsc_stack import PetscStack


class SparseInverse:
    """S_s^-1 through [[A_s, -T_s^T], [-T_s, D_s]] (y, x) = (0, -r), whose x is S_s^-1 r.

    The first row gives y = A_s^-1 T_s^T x, the second then S_s x = r. With A_s eliminated what is left is -S_s, so
    that by Sylvester's law the matrix has as many negative eigenvalues as -S_s: one for each interface unknown with a
    jump, none for a reaction. That inertia is checked, as Cholesky checks the blocks of the dense inverse.

    PETSc options (prefix ``inverse_``): factorised by MUMPS (LDL^T); another package must tell the inertia too.

    Parameters
    ----------
    matrix : (n_field, n_field) csr_matrix
        A_s, the camera's motion held.
    local : LocalDual
        The subdomain's T_s and D_s.

    Raises
    ------
    SingularSubdomainError
        Where S_s is singular.
    """

    def __init__(self, matrix: sparse.csr_matrix, local: LocalDual) -> None:
        self._n_field = matrix.shape[0]
        with PetscStack() as stack:
            saddle_point = stack.keep(_build_saddle_point(matrix, local))
            ksp = stack.keep(create_ksp(PETSc.COMM_SELF, INVERSE))
            ksp.setOperators(saddle_point)
            ksp.setFromOptions()
            self._left = stack.keep(saddle_point.createVecLeft())
            self._right = stack.keep(saddle_point.createVecRight())
            self._right.set(0.0)
            # A failure here is one of memory, hence PETSc's own error: MUMPS goes on past null pivots and counts them.
            ksp.setUp()
            self._factor = stack.keep(ksp.getPC().getFactorMatrix())
            self._check_inertia(local.n_jumps)
            self._objects = stack.pop_all()

    def _check_inertia(self, n_negative: int) -> None:
        """Raise SingularSubdomainError where the factor has not so many negative eigenvalues, or some that are zero."""
        if self._factor.getInertia()[:2] != (n_negative, 0):
            raise SingularSubdomainError(SINGULAR_INTERFACE)

    def apply(self, r: NDArray[np.float64]) -> NDArray[np.float64]:
        """Apply S_s^-1.

        Parameters
        ----------
        r : (n interface unknowns,) array
            r.

        Returns
        -------
        (n interface unknowns,) array
            S_s^-1 r.
        """
        self._right.getArray()[self._n_field:] = -r
        self._factor.solve(self._right, self._left)
        return np.array(self._left.getArray(readonly=1)[self._n_field:])

    def destroy(self) -> None:
        """Free the factor."""
        self._objects.close()


SINGULAR_INTERFACE = ("the interface problem of a subdomain is singular to rounding; use larger subdomains, or a "
                      "shorter regularization.cut_off_wavelength")


def _build_saddle_point(matrix: sparse.csr_matrix, local: LocalDual) -> PETSc.Mat:
    """The upper triangle of [[A_s, -T_s^T], [-T_s, D_s]] as PETSc's symmetric matrix."""
    n = len(local.compliance)
    # Unknowns with jumps have zeros in D_s, which must be stored: PETSc wants all diagonal entries.
    corner = sparse.csr_matrix((local.compliance, (np.arange(n), np.arange(n))), shape=(n, n))
    upper = sparse.bmat([[sparse.triu(matrix, format="csr"), -local.trace.T], [None, corner]], format="csr")
    upper.sort_indices()
    csr = (to_petsc_integers(upper.indptr, "entries of a subdomain's interface problem"),
           to_petsc_integers(upper.indices, "unknowns of a subdomain's interface problem"), upper.data)
    return PETSc.Mat().createSBAIJ(upper.shape, 1, csr=csr, comm=PETSc.COMM_SELF)
