"""``ddic`` as if PETSc had been built without some of its packages: neither told of nor to be had.

Usage: python -m bench.support.absent_packages PACKAGE[,PACKAGE] run case.toml: PACKAGE is suitesparse or mumps.
"""

from __future__ import annotations

import ctypes
import sys
from pathlib import Path

from petsc4py import PETSc

from ddic.cli.app import command_line
from ddic.solvers import petsc
from ddic.solvers.local_system import MISSING_PACKAGE

MATRICES = ("seqaij", "mpiaij", "seqsbaij", "mpisbaij")
FACTORS = (1, 2)
"""PETSc's numbers of LU and Cholesky."""
PACKAGES = {"suitesparse": "cholmod", "mumps": "mumps"}
"""Names of PETSc's packages, and of what they factorise with."""

_Maker = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p)


def _refuse(matrix: int, kind: int, factor: int) -> int:
    return MISSING_PACKAGE


_MAKER = _Maker(_refuse)


def _library() -> ctypes.CDLL:
    """The library that petsc4py has loaded."""
    PETSc.Sys.getVersion()
    mapped = Path("/proc/self/maps").read_text(encoding="utf-8").split()
    return ctypes.CDLL(next(word for word in mapped if Path(word).name.startswith("libpetsc")))


def take_away(*absent: str) -> None:
    """Take packages from this process, for good: PETSc has no way to give their factors back.

    Parameters
    ----------
    *absent : str
        Keys of PACKAGES.
    """
    register = _library().MatSolverTypeRegister
    for name in absent:
        for matrix in MATRICES:
            for kind in FACTORS:
                if register(PACKAGES[name].encode(), matrix.encode(), kind, _MAKER):
                    raise RuntimeError(f"{name} cannot be taken away")
    has_package = petsc.has_package
    hidden = {*absent, *(petsc.WITH_CHOLMOD if "suitesparse" in absent else ())}
    petsc.has_package = lambda name: name not in hidden and has_package(name)


if __name__ == "__main__":
    take_away(*sys.argv[1].split(","))
    sys.argv = ["ddic", *sys.argv[2:]]
    command_line()
