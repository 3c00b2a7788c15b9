"""PETSc option prefixes and their defaults, in one place; the command line overrides them."""

from __future__ import annotations

from petsc4py import PETSc

LOCAL = "local_"
DUAL = "dual_"
COARSE = "coarse_"

DEFAULTS: dict[str, dict[str, str]] = {
    LOCAL: {
        "ksp_type": "preonly",
        "pc_type": "cholesky",
        "pc_factor_mat_solver_type": "cholmod",
        "mat_cholmod_print": "0",
    },
    COARSE: {
        "ksp_type": "preonly",
        "pc_type": "cholesky",
        "pc_factor_mat_solver_type": "mumps",
    },
    DUAL: {
        "ksp_type": "gmres",
        "ksp_pc_side": "right",
        "ksp_norm_type": "unpreconditioned",
        "ksp_gmres_modifiedgramschmidt": "",
    },
}


def configured_ksp(comm: PETSc.Comm, prefix: str) -> PETSc.KSP:
    """Create a KSP with a prefix and its defaults, where the user's options say nothing else.

    The caller sets operators and tolerances, then calls ``setFromOptions`` last.
    """
    options = PETSc.Options()
    for name, value in DEFAULTS[prefix].items():
        if not options.hasName(prefix + name):
            options.setValue(prefix + name, value)
    ksp = PETSc.KSP().create(comm)
    ksp.setOptionsPrefix(prefix)
    return ksp
