"""The coarse problem of the dual solver as a rank sees it: its sizes and the CPU seconds of its factorisation."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from petsc4py import PETSc

from ddic.solvers.dual.coarse_space import CoarseSpace


def record_coarse(keep: Callable[[dict[str, float]], None]) -> None:
    """Hand over sizes and CPU seconds of every coarse matrix that is factorised from here on.

    Where several ranks factorise, a rank that waits for another one spins: seconds are then more than its work.

    Parameters
    ----------
    keep : callable
        What takes ``coarse_vectors``, ``coarse_nonzeros`` and ``coarse_factor_cpu_s``.
    """
    set_up = CoarseSpace._factorize

    def factorize(*arguments: Any) -> PETSc.KSP:
        begin = time.process_time()
        ksp = set_up(*arguments)
        matrix = ksp.getOperators()[0]
        keep({"coarse_vectors": matrix.getSize()[0], "coarse_factor_cpu_s": time.process_time() - begin,
              "coarse_nonzeros": matrix.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]})
        return ksp

    # setattr, because a method is replaced on purpose.
    setattr(CoarseSpace, "_factorize", staticmethod(factorize))  # noqa: B010
