"""Displacement noise that camera noise leaves: covariance 2 sigma^2 A^-1 M A^-1."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.solvers.linear_step import AllowedError, LinearStep
from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.random_bits import generate_bits

_PROBES = 64
"""Random vectors: about 1 % of error for a thousand displacements; twice as many halve its square, for
twice the time."""

_SIGNS_BY_STEPS = 20_000
"""Random signs where each vector of them takes a linear step of the whole problem: a few per cent of error, which the
order of the noise needs not. A larger value takes more vectors, of which large problems need one."""

_MOST_BY_STEPS = 4
"""Vectors that small problems take at most."""

_ENOUGH = AllowedError(0.0, 0.1)
"""Share of a vector's solution that its linear step may leave: 0.02 changed the noise by 0.2 % on 3000 x 3000 pixels,
with twice the iterations."""


def estimate_noise_rms(system: LocalSystem, operator: LocalOperator, sigma: float,
                       components: NDArray[np.bool_]) -> float:
    """Estimate the displacement noise of white camera noise, by the trace of T A^-1 M A^-1 T^T with random signs.

    Parameters
    ----------
    system : LocalSystem
        Of the whole region as one domain.
    operator : LocalOperator
        The factor of its A.
    sigma : float
        Standard deviation of the camera noise of both images, grey levels.
    components : (mesh.n_dofs,) array of bool
        Which components of the nodes' displacements count, node by node.

    Returns
    -------
    float
        RMS over these components, pixels.
    """
    signs = np.random.default_rng(0).choice([-1.0, 1.0], size=(len(components), _PROBES)) * components[:, None]
    tangent = system.subdomain.kinematics.tangent
    y = operator.solve_many(tangent.T @ signs)
    trace = (y * (system.hessian @ y)).sum() / _PROBES
    return float(sigma * np.sqrt(2.0 * trace / components.sum()))


@dataclass(frozen=True)
class NoiseResponse:
    """How a field answers white noise of the images.

    Attributes
    ----------
    rms_per_grey : float
        RMS of a component at a node, pixels, for noise of both images of one grey level.
    n_determined : float
        tr(A^-1 M): how many unknowns the images determine.
    """

    rms_per_grey: float
    n_determined: float


def estimate_response(team: Team, systems: Sequence[LocalSystem], step: LinearStep,
                      counted: Sequence[NDArray[np.bool_]] | None = None) -> NoiseResponse:
    """Estimate the same over all nodes of a problem in subdomains, by linear steps of any kind; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    systems : sequence of LocalSystem
        Of owned subdomains.
    step : LinearStep
        Solves with A.
    counted : sequence of (n_nodes,) bool array, optional
        Which nodes of each subdomain count; all of them by default.

    Returns
    -------
    NoiseResponse
        Every node counted once; with several cameras of noise of the first one.

    Raises
    ------
    ConvergenceError
        On all ranks, where a linear step does not converge.
    """
    at_rest = [np.zeros(system.subdomain.n_unknowns) for system in systems]
    chosen = [np.ones(system.subdomain.mesh.n_nodes) for system in systems]
    if counted is not None:
        chosen = [of_nodes.astype(np.float64) for of_nodes in counted]
    # Of nodes, a share in each subdomain that has them.
    shares = [of_nodes / system.subdomain.node_multiplicity for system, of_nodes in zip(systems, chosen, strict=True)]
    # Solutions of about a pixel: steps start from their last one.
    (scale,) = team.ordered_sum([np.array([system.hessian.diagonal().max(initial=0.0)]) for system in systems])
    (n_components,) = team.ordered_sum([np.array([system.subdomain.mesh.dim * share.sum()])
                                        for system, share in zip(systems, shares, strict=True)])
    n_components = max(n_components, 1.0)
    traces = []
    for probe in range(int(np.clip(_SIGNS_BY_STEPS // n_components, 1, _MOST_BY_STEPS))):
        b = [scale * _project_signs(system.subdomain, share, probe)
             for system, share in zip(systems, shares, strict=True)]
        y = [y_s / scale for y_s in step.solve(at_rest, b, _ENOUGH).dq]
        forces = [system.hessian @ y_s for system, y_s in zip(systems, y, strict=True)]
        traces.append(team.ordered_sum([
            np.array([y_s @ of_y, _project_signs(system.subdomain, of_nodes, probe) @ of_y])
            for system, of_nodes, y_s, of_y in zip(systems, chosen, y, forces, strict=True)]))
    of_covariance, of_determined = np.mean(traces, axis=0)
    return NoiseResponse(float(np.sqrt(2.0 * of_covariance / n_components)), float(of_determined))


def _project_signs(subdomain: Subdomain, shares: NDArray[np.float64], probe: int) -> NDArray[np.float64]:
    """A subdomain's part of T^T z, z of random signs that are the same whatever the partition, (n_unknowns,)."""
    dim = subdomain.mesh.dim
    components = (subdomain.node_ids[:, None] * dim + np.arange(dim)).ravel()
    signs = 1.0 - 2.0 * generate_bits(components, probe)
    shared = signs * np.repeat(shares, dim)
    b = np.zeros(subdomain.n_unknowns)
    b[:subdomain.n_field] = subdomain.kinematics.tangent.T @ shared
    return b
