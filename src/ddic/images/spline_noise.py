"""What interpolation by a spline leaves of the noise of pixels, and how it makes neighbours' noise go together."""

from __future__ import annotations

from functools import cache
from math import comb, factorial

import numpy as np
from numpy.typing import NDArray

from ddic.images.spline import HALO, compute_coefficients

Array = NDArray[np.float64]

REACH = 12
"""Largest distance, pixels, of values whose noise goes together: the poles' powers leave 1e-4 of it there (0.43^12)."""

NOISE_OF_SLOPE = {3: 1.39, 5: 1.89}
"""Variance of the slope of a spline through white noise at its nodes, relative to the noise's, per pixel squared, by
degree: for the cubic one the mean of (3 sin w / (2 + cos w))^2 over all frequencies w."""


def correlate_interpolation(shift: float, degree: int) -> Array:
    """Find how the noise of interpolated values goes together: R(k) = sum_m h(m) h(m + k) with the weights h of pixels.

    The B-spline of a degree with its prefilter weighs the pixels about a point between two of them; h is that along one
    axis. In two dimensions R is the product of both axes', and the value at no distance is the noise transfer: the
    variance of an interpolated value over that of a pixel.

    Parameters
    ----------
    shift : float
        Of the values from pixels, pixels.
    degree : int
        Of the spline, 3 or 5.

    Returns
    -------
    (2 REACH + 1,) array
        R for k from -REACH to REACH, no unit; 1 at k = 0 alone where the shift is a whole number.
    """
    weights = _weigh_pixels(shift % 1.0, degree)
    whole = np.correlate(weights, weights, mode="full")
    middle = len(weights) - 1
    return np.asarray(whole[middle - REACH: middle + REACH + 1])


def _weigh_pixels(shift: float, degree: int) -> Array:
    """Weights of pixels in the value at ``shift``, of 2 HALO + 1 pixels about it."""
    n = HALO[degree]
    places = np.arange(-n, n + 1)
    # The value is sum_k c[k] B(shift - k); c of pixels that are 1 at m alone is c_0[k - m].
    basis = _evaluate_basis(shift - places, degree)
    return np.asarray(np.convolve(basis, _coefficients_of_one_pixel(degree), mode="same"))


def _evaluate_basis(x: Array, degree: int) -> Array:
    """The centred B-spline B(x) as a sum of truncated powers, from its nearer end: no difference of large numbers."""
    from_end = 0.5 * (degree + 1) - np.abs(x)
    terms = [(-1) ** k * comb(degree + 1, k) * np.maximum(from_end - k, 0.0) ** degree for k in range(degree + 1)]
    return np.asarray(np.sum(terms, axis=0) / factorial(degree))


@cache
def _coefficients_of_one_pixel(degree: int) -> Array:
    """Coefficients along a row of pixels of which the middle one is 1 and the others are 0."""
    n = HALO[degree]
    # Along columns nothing varies.
    row = np.zeros((1, 2 * n + 1))
    row[0, n] = 1.0
    return np.asarray(compute_coefficients(row, degree)[0])
