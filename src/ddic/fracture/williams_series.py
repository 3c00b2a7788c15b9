"""Williams' series of displacements about the tip of a straight crack whose faces are free."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def find_kolosov_constant(poisson_ratio: float, plane: str) -> float:
    """Find Kolosov's constant kappa.

    Parameters
    ----------
    poisson_ratio : float
        nu, no unit.
    plane : str
        "stress" or "strain".

    Returns
    -------
    float
        (3 - nu) / (1 + nu), or 3 - 4 nu.
    """
    return (3 - poisson_ratio) / (1 + poisson_ratio) if plane == "stress" else 3 - 4 * poisson_ratio


def evaluate_williams_series(points: Array, orders: NDArray[np.int64], kappa: float) -> Array:
    """Evaluate the terms r^(n/2) of both modes, in the frame of the crack.

    Parameters
    ----------
    points : (n, 2) array
        From the tip, x ahead of the crack; faces at x < 0 where the sign of y tells them apart, pixels.
    orders : (n_orders,) array of int64
        n: 0 is a translation, 1 the singular strain, 2 the T-stress and a rotation; -1 is more singular than any
        crack, and tells that the tip lies elsewhere.
    kappa : float
        Kolosov's constant.

    Returns
    -------
    (n, 2, 2 n_orders) array
        Displacement 2 mu u of a unit of each coefficient: first the opening mode of each order, then the sliding one.
    """
    r, theta = np.hypot(points[:, 0], points[:, 1]), np.arctan2(points[:, 1], points[:, 0])
    half = orders / 2
    sign = (-1.0) ** np.abs(orders)
    power = r[:, None] ** half
    one, other = half * theta[:, None], (half - 2) * theta[:, None]
    opening_x = (kappa + half + sign) * np.cos(one) - half * np.cos(other)
    opening_y = (kappa - half - sign) * np.sin(one) + half * np.sin(other)
    sliding_x = -(kappa + half - sign) * np.sin(one) + half * np.sin(other)
    sliding_y = (kappa - half + sign) * np.cos(one) + half * np.cos(other)
    along_x = np.concatenate([power * opening_x, power * sliding_x], axis=1)
    along_y = np.concatenate([power * opening_y, power * sliding_y], axis=1)
    return np.stack([along_x, along_y], axis=1)
