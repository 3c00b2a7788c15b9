"""Degrees of freedom that a regularized field takes from the images: tr(A^-1 M)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ddic.parallel.team import Team
from ddic.solvers.linear_step import AllowedError, LinearStep
from ddic.solvers.local_system import LocalSystem

N_PROBES = 4
"""Random vectors. Their mean is off by sqrt(2 / (N_PROBES trace)) of the trace: 3 % of 500; four times as many halve
it, for four times the solves."""

_ENOUGH_FOR_TRACE = AllowedError(0.0, 0.01)
"""Share of a vector's solution that its linear step may leave: below what the random signs leave."""


def estimate_degrees_of_freedom(team: Team, systems: Sequence[LocalSystem], step: LinearStep) -> float:
    """Estimate tr(A^-1 M) by Hutchinson's random signs; collective.

    By so much do small changes of the images' grey levels appear in the field: the number of unknowns without
    regularization, fewer where mechanics rule some of them.

    Parameters
    ----------
    team : Team
        All ranks.
    systems : sequence of LocalSystem
        Of owned subdomains.
    step : LinearStep
        Solves with A.

    Returns
    -------
    float
        No unit.

    Raises
    ------
    ConvergenceError
        On all ranks, where a linear step does not converge.
    """
    at_rest = [np.zeros(system.subdomain.n_unknowns) for system in systems]
    # Solutions of about a pixel, by which steps judge how exact they are.
    (scale,) = team.ordered_sum([np.array([system.hessian.diagonal().max(initial=0.0)]) for system in systems])
    n_unknowns = team.maximum(max(int(system.subdomain.numbers.max(initial=-1)) for system in systems)) + 1
    traces = []
    for probe in range(N_PROBES):
        signs = _draw_signs(n_unknowns, probe)
        own = [signs[system.subdomain.numbers] for system in systems]
        b = [scale * z / system.subdomain.all_multiplicity for z, system in zip(own, systems, strict=True)]
        y = [y_s / scale for y_s in step.solve(at_rest, b, _ENOUGH_FOR_TRACE).dq]
        (trace,) = team.ordered_sum([np.array([z @ (system.hessian @ y_s)])
                                     for z, y_s, system in zip(own, y, systems, strict=True)])
        traces.append(float(trace))
    return float(np.mean(traces))


def _draw_signs(n: int, probe: int) -> NDArray[np.float64]:
    """Random signs of all unknowns, the same on every rank and for every partition, (n,)."""
    return np.random.default_rng(probe).choice([-1.0, 1.0], size=n)
