"""Independent unregularized FE-DIC on each subdomain: the last stage of the start [BP17, Fig. 5]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.errors import ConvergenceError, SingularSubdomainError
from ddic.functionals.grey_levels import GreyCorrection
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.solvers.gauss_newton import OwnedPart, Tolerances, gauss_newton, silent
from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.monolithic import MonolithicStep

TOLERANCES = Tolerances(relative=1e-3, rms=1e-2, max_iterations=10)


@dataclass(frozen=True)
class IndependentStart:
    """Displacement of each owned subdomain (n_dofs,), and the subdomains that kept what they had."""

    q: list[NDArray[np.float64]]
    kept: list[int]


def independent_start(parts: Sequence[OwnedPart], systems: Sequence[LocalSystem], q: Sequence[NDArray[np.float64]],
                      smallest_eigenvalue: float, correction: GreyCorrection) -> IndependentStart:
    """Run FE-DIC on every owned subdomain by itself; free of communication.

    A subdomain whose M_s is singular or that does not converge keeps its q and is listed.
    """
    fields, kept = [], []
    for part, system, q_s in zip(parts, systems, q, strict=True):
        try:
            fields.append(_alone(part, system, q_s, smallest_eigenvalue, correction))
        except (SingularSubdomainError, ConvergenceError):
            fields.append(q_s)
            kept.append(part.subdomain.index)
    return IndependentStart(fields, kept)


def _alone(part: OwnedPart, system: LocalSystem, q: NDArray[np.float64], smallest_eigenvalue: float,
           correction: GreyCorrection) -> NDArray[np.float64]:
    unregularized = LocalSystem(part.subdomain, system.hessian, None, system.row_weights, 0.0)
    operator = LocalOperator(system.hessian, smallest_eigenvalue=smallest_eigenvalue, where="independent start")
    try:
        solution = gauss_newton(Team(MPI.COMM_SELF), [part], [q], MonolithicStep(unregularized, operator),
                                correction, TOLERANCES, silent, PhaseClock())
    finally:
        operator.destroy()
    return solution.q[0]
