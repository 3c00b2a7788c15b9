"""PETSc option prefixes and their defaults, in one place; the command line overrides them."""

from __future__ import annotations

from petsc4py import PETSc

from ddic.solvers.factor_packages import PACKAGE, REPLICATED, choose_local_package, is_mumps_missing
from ddic.solvers.freed_memory import release_freed_memory

# At import, for PETSc's libraries change malloc when they are loaded, and assembly comes before the first solver.
release_freed_memory()

LOCAL = "local_"
DUAL = "dual_"
COARSE = "coarse_"
INVERSE = "inverse_"
ASSEMBLED = "assembled_"
CONJUGATE_GRADIENT = "cg_"

DEFAULTS: dict[str, dict[str, str]] = {
    LOCAL: {
        "ksp_type": "preonly",
        "pc_type": "cholesky",
        "mat_cholmod_print": "0",
        # Operations an entry of the factor from which on it is made by dense blocks: below, of subdomains of some
        # hundred unknowns, these take longer (at 40, CHOLMOD's own, by a half); beyond, entry by entry takes longer.
        "mat_cholmod_supernodal_switch": "100",
    },
    COARSE: {
        "ksp_type": "preonly",
        "ksp_error_if_not_converged": "true",
        "pc_type": "cholesky",
        "pc_factor_mat_solver_type": "mumps",
        # Room beyond MUMPS's estimate, in per cent: nearly dependent coarse vectors delay pivots.
        "mat_mumps_icntl_14": "100",
    },
    INVERSE: {
        "ksp_type": "preonly",
        "ksp_error_if_not_converged": "true",
        "pc_type": "cholesky",
        "pc_factor_mat_solver_type": "mumps",
        # Room beyond MUMPS's estimate, in per cent: the zeros of D_s delay pivots, of small matrices most.
        "mat_mumps_icntl_14": "200",
        # Null pivots are counted: the inertia tells a singular interface problem.
        "mat_mumps_icntl_24": "1",
    },
    ASSEMBLED: {
        "ksp_type": "preonly",
        "pc_type": "cholesky",
        "pc_factor_mat_solver_type": "mumps",
    },
    CONJUGATE_GRADIENT: {
        "ksp_type": "cg",
        "ksp_norm_type": "preconditioned",
        "pc_type": "jacobi",
    },
    DUAL: {
        "ksp_type": "gmres",
        "ksp_pc_side": "right",
        "ksp_norm_type": "unpreconditioned",
        "ksp_gmres_modifiedgramschmidt": "",
    },
}


def create_ksp(comm: PETSc.Comm, prefix: str) -> PETSc.KSP:
    """Create a Krylov solver or factor with an option prefix and its defaults, where the user says nothing else.

    The caller sets operators and tolerances, then calls ``setFromOptions`` last.

    Parameters
    ----------
    comm : PETSc.Comm
        Its ranks.
    prefix : str
        A key of ``DEFAULTS``.

    Returns
    -------
    PETSc.KSP
        The caller's to destroy.
    """
    options = PETSc.Options()
    for name, value in _choose_defaults(prefix).items():
        if not options.hasName(prefix + name):
            options.setValue(prefix + name, value)
    ksp = PETSc.KSP().create(comm)
    ksp.setOptionsPrefix(prefix)
    return ksp


def _choose_defaults(prefix: str) -> dict[str, str]:
    """The defaults of a prefix, as far as PETSc has the packages that they name."""
    defaults = DEFAULTS[prefix]
    if prefix == LOCAL:
        return defaults | {PACKAGE: choose_local_package()}
    if defaults.get(PACKAGE) == "mumps" and is_mumps_missing(prefix):
        return REPLICATED if prefix == COARSE else defaults | {PACKAGE: choose_local_package()}
    return defaults
