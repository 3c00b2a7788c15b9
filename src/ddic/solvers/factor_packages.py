"""Which packages factorise what, where PETSc was built without CHOLMOD or MUMPS."""

from __future__ import annotations

from petsc4py import PETSc

from ddic.errors import InputError

PACKAGE = "pc_factor_mat_solver_type"
"""PETSc's option that names a package, behind the prefix of what is factorised."""

REPLICATED = {
    "ksp_type": "preonly",
    "ksp_error_if_not_converged": "true",
    "pc_type": "redundant",
    "redundant_ksp_type": "preonly",
    "redundant_pc_type": "cholesky",
    # Quasi-definite, hence factorised in any order: small pivots come from vectors that hardly differ, and are right.
    "redundant_pc_factor_zeropivot": "1e-20",
}
"""Options in place of a parallel factor: PETSc's own LDL^T of the whole matrix on every rank."""

WITH_CHOLMOD = ("suitesparse", "cholmod")
"""Names that say that PETSc has CHOLMOD: 3.18 goes by the collection, 3.26 by its members."""

LOCAL_FACTORS = ("dual", "monolithic")
"""Methods that factorise each subdomain's own operator."""


def has_package(name: str) -> bool:
    """Tell whether PETSc was built with a package.

    Parameters
    ----------
    name : str
        Such as ``"suitesparse"``.

    Returns
    -------
    bool
        Whether it was.
    """
    return bool(PETSc.Sys.hasExternalPackage(name))


def choose_local_package() -> str:
    """Choose what factorises a matrix on one rank: CHOLMOD, else MUMPS, else PETSc itself.

    Returns
    -------
    str
        For ``pc_factor_mat_solver_type``.
    """
    if any(has_package(name) for name in WITH_CHOLMOD):
        return "cholmod"
    return "mumps" if has_package("mumps") else "petsc"


def is_mumps_missing(prefix: str) -> bool:
    """Tell whether MUMPS is meant to factorise something, and PETSc was built without it.

    Parameters
    ----------
    prefix : str
        Of the options of what is factorised.

    Returns
    -------
    bool
        False where the user names a package.
    """
    return not has_package("mumps") and not PETSc.Options().hasName(prefix + PACKAGE)


def require_packages(where: str, method: str, local_inverse: str, n_ranks: int) -> None:
    """Refuse what PETSc cannot factorise without MUMPS.

    Parameters
    ----------
    where : str
        The case file.
    method : str
        ``solver.method``.
    local_inverse : str
        ``solver.local_inverse``.
    n_ranks : int
        MPI ranks that were started.

    Raises
    ------
    InputError
        Where nothing takes its place.
    """
    if method == "assembled" and n_ranks > 1 and is_mumps_missing("assembled_"):
        raise InputError(f'{where}: solver.method = "assembled" on {n_ranks} MPI ranks needs MUMPS, and PETSc was '
                         'built without it; use "conjugate_gradient" or "dual", start one rank, or build PETSc with '
                         "MUMPS (docs/installation.md)")
    # Left open, the method is the dual one where this key is given.
    if method in ("auto", "dual") and local_inverse == "sparse" and is_mumps_missing("inverse_"):
        raise InputError(f'{where}: solver.local_inverse = "sparse" needs MUMPS, and PETSc was built without it; use '
                         '"auto" or "dense", or build PETSc with MUMPS (docs/installation.md)')


def describe_missing_packages(method: str) -> tuple[str, ...]:
    """Say what is factorised by another package than the one that was meant.

    Parameters
    ----------
    method : str
        ``solver.method``.

    Returns
    -------
    tuple of str
        A line for each package that PETSc was built without and the method would use.
    """
    lines = []
    chosen = choose_local_package()
    if (method in LOCAL_FACTORS and chosen != "cholmod"
            and PETSc.Options().getString("local_" + PACKAGE, chosen) == chosen):
        lines.append(f"PETSc was built without SuiteSparse: {chosen} factorises the operators in CHOLMOD's place")
    if method == "dual" and is_mumps_missing("coarse_"):
        lines.append("PETSc was built without MUMPS: inverses of subdomains are arrays whatever their size, and a "
                     "coarse problem is factorised on every rank by PETSc itself")
    if method == "assembled" and is_mumps_missing("assembled_"):
        lines.append(f"PETSc was built without MUMPS: {chosen} factorises the operator in its place")
    return tuple(lines)
