"""Whether the address space that a process may use (``ulimit -v``) is enough to start in."""

from __future__ import annotations

import os

from ddic.errors import DdicError

LEAST_BYTES = 1536 * 2**20
"""Address space below which nothing is begun. A run on small images takes 1.05 GiB, most of it libraries: with less
they fail in ways of their own, and OpenBLAS asks again and again, for ever, for memory that it does not get. A larger
value refuses limits that would do."""


def require_address_space() -> None:
    """Refuse a limit on the address space that is too small to start in; call it before numpy is imported.

    Where there is a limit OpenBLAS gets one thread, unless the environment says otherwise: each reserves memory.

    Raises
    ------
    DdicError
        Which names the limit and what is needed.
    """
    limit = _find_limit()
    if limit is None:
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if limit < LEAST_BYTES:
        raise DdicError(f"the address space of a process is limited to {limit / 2**20:.0f} MiB (ulimit -v), ddic needs "
                        f"{LEAST_BYTES / 2**20:.0f} MiB and what the images take: raise the limit")


def prepare_workspaces() -> None:
    """Let each library of linear algebra take its workspace while there is room; without a limit do nothing.

    numpy, scipy and PETSc bring one each. OpenBLAS takes it at its first product, and loops for ever without.
    """
    if _find_limit() is None:
        return
    import numpy as np
    from petsc4py import PETSc
    from scipy.linalg import blas

    some = np.ones((64, 64), order="F")
    np.linalg.det(some @ some)
    blas.dgemm(1.0, some, some)
    matrix = PETSc.Mat().createDense((64, 64), array=some, comm=PETSc.COMM_SELF)
    product = matrix.matMult(matrix)
    product.destroy()
    matrix.destroy()


def _find_limit() -> int | None:
    """Bytes of address space that a process may have; None for no limit."""
    try:
        import resource
    except ImportError:  # a system without such limits
        return None
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if limit == resource.RLIM_INFINITY else limit
