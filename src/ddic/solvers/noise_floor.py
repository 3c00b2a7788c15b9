"""Displacement noise that camera noise leaves: covariance 2 sigma^2 A^-1 M A^-1."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.local_system import LocalSystem

_PROBES = 64


def expected_noise_rms(system: LocalSystem, operator: LocalOperator, sigma: float,
                       dofs: NDArray[np.bool_]) -> float:
    """RMS over chosen dofs of the displacement noise, pixels, for white noise sigma (grey levels) in both images.

    system, operator: of the whole region as one domain; dofs: (n_dofs,). The trace of A^-1 M A^-1 is estimated
    with random signs on the chosen dofs (64 probes: about 1 % for a thousand dofs).
    """
    signs = np.random.default_rng(0).choice([-1.0, 1.0], size=(len(dofs), _PROBES)) * dofs[:, None]
    y = operator.solve_many(signs)
    trace = (y * (system.hessian @ y)).sum() / _PROBES
    return float(sigma * np.sqrt(2.0 * trace / dofs.sum()))
