"""Displacement noise that camera noise leaves: covariance 2 sigma^2 A^-1 M A^-1."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.local_system import LocalSystem

_PROBES = 64
"""Random vectors: about 1 % of error for a thousand displacements; twice as many halve its square, for
twice the time."""


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
