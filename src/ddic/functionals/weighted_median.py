"""Medians and other quantiles of values that count more or less."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


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
    order = np.argsort(values)
    reached = np.cumsum(weights[order])
    place = int(np.searchsorted(reached, share * reached[-1]))
    return float(values[order[place]])


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
