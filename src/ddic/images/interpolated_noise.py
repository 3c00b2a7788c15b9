"""What interpolation by a spline leaves of white noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_REACH = 24
"""Pixels beyond which a pixel's part in an interpolated value is below 1e-8: the quintic's pole is 0.43."""

_N_OFFSETS = 65
"""Sub-pixel positions at which the variance is tabulated; between them it is interpolated linearly."""


def average_noise_transfer(displacement: NDArray[np.float64], degree: int) -> float:
    """Average the variance of interpolated white noise over displaced pixel centres, relative to the noise's.

    A spline between pixels is a weighted mean of them: 1 at pixel centres, 0.57 between four of them with the cubic
    (products of both axes). It lowers the variance of fine noise alone, not what noise does to the displacement, whose
    wavelengths are those of the speckle.

    Parameters
    ----------
    displacement : (n, 2) array
        Pixels; rows that are not finite do not count.
    degree : int
        Of the spline, 3 or 5.

    Returns
    -------
    float
        From 0 to 1; 1 without any point.
    """
    finite = displacement[np.isfinite(displacement).all(axis=1)]
    if not len(finite):
        return 1.0
    offsets = np.linspace(0.0, 1.0, _N_OFFSETS)
    variance = _compute_variance(offsets, degree)
    along = np.interp(finite % 1.0, offsets, variance)
    return float(np.prod(along, axis=1).mean())


def _compute_variance(offsets: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    """Sum of squares of the weights of all pixels in a value interpolated at offsets along one axis."""
    from scipy import ndimage

    impulse = np.zeros(4 * _REACH + 1)
    impulse[2 * _REACH] = 1.0
    coefficients = ndimage.spline_filter1d(impulse, degree, mode="mirror")
    pixels = np.arange(_REACH, 3 * _REACH + 1)
    positions = pixels[:, None] + offsets[None, :]
    weights = ndimage.map_coordinates(coefficients, [positions.ravel()], order=degree, prefilter=False, mode="mirror")
    return np.asarray((weights.reshape(positions.shape) ** 2).sum(axis=0))
