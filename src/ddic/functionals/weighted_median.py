"""Medians and other quantiles of values that count more or less."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FEW = 500
"""Values that are sorted as quickly as halved."""


def find_weighted_quantile(values: NDArray[np.float64], weights: NDArray[np.float64], share: float) -> float:
    """Find the value below which lies a share of all weight.

    Parameters
    ----------
    values : (n,) array
        At least one.
    weights : (n,) array
        Not negative, not all of them 0.
    share : float
        Between 0 and 1.

    Returns
    -------
    float
        One of the values.
    """
    left = share * weights.sum()
    # To sort all of them would take five times as long.
    while len(values) > FEW:
        middle = len(values) // 2
        order = np.argpartition(values, middle)
        lower, upper = order[:middle], order[middle:]
        of_lower = weights[lower].sum()
        is_upper = of_lower < left
        left -= of_lower if is_upper else 0.0
        values, weights = (of_all[upper if is_upper else lower] for of_all in (values, weights))
    order = np.argsort(values)
    place = int(np.searchsorted(np.cumsum(weights[order]), left))
    # Sums that round may leave the last value out.
    return float(values[order[min(place, len(order) - 1)]])


def find_weighted_median(values: NDArray[np.float64], weights: NDArray[np.float64]) -> float:
    """Find the value below which lies half of all weight.

    Parameters
    ----------
    values : (n,) array
        At least one.
    weights : (n,) array
        Not negative, not all of them 0.

    Returns
    -------
    float
        One of the values.
    """
    return find_weighted_quantile(values, weights, 0.5)
