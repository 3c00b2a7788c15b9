"""Why PETSc could not factorise a matrix, and what to do about it."""

from __future__ import annotations

from petsc4py import PETSc

from ddic.errors import DdicError, FactorizationError, SingularSubdomainError
from ddic.solvers.singularity import describe_singular

OUT_OF_MEMORY = 55
"""PETSc's number of the error."""

MISSING_PACKAGE = 92
"""PETSc's number of the error."""

ZERO_PIVOT = (71, 81)
"""PETSc's numbers of the error, of LU and of Cholesky."""


def describe_failure(error: PETSc.Error, where: str) -> DdicError:
    """Describe a failure by an error that says what the user can do.

    Parameters
    ----------
    error : PETSc.Error
        Of the factorisation.
    where : str
        What the matrix belongs to.

    Returns
    -------
    DdicError
        To be raised: a singular operator, one that is too large, a missing solver package, or what PETSc says.
    """
    if error.ierr in ZERO_PIVOT:
        return SingularSubdomainError(describe_singular(where))
    said = str(error).strip().splitlines()[-1].removeprefix("[0] ")
    if error.ierr == OUT_OF_MEMORY:
        return FactorizationError(f"{where}: not enough memory to factorise its operator; give more solver.subdomains, "
                                  'start more ranks, or use solver.method = "conjugate_gradient"')
    if error.ierr == MISSING_PACKAGE:
        return FactorizationError(f"{where}: PETSc was built without the solver package that is asked for ({said}); "
                                  "choose another by -local_pc_factor_mat_solver_type mumps, or petsc")
    return FactorizationError(f"{where}: its operator could not be factorised, most often for want of memory: {said} "
                              f"(PETSc's error {error.ierr}); give more solver.subdomains or start more ranks")
