"""Residual, gain and offset of grey levels f and g(x + u), from six sums over pixels; quantiles of weighted values."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ddic.arrays import Array, BoolArray

GreyCorrection = Literal["none", "global", "element"]
"""Whose gain a and offset b in f = a g + b are fitted: nobody's, each camera's, each cell's."""

FLAT = 1e-12
"""Variance of grey levels relative to their mean square, no unit, up to which they are flat: rounding of float64 sums
leaves some 1e-15. Where it is larger, more regions get no gain."""

_TINY = 1e-300
"""A mean square, grey levels squared, below any that is not 0."""


def find_flat(variance: Array, mean_square: Array) -> BoolArray:
    """Find where grey levels are all alike, (...,): what is left of their variance is rounding."""
    return np.asarray(variance <= FLAT * np.maximum(mean_square, _TINY))


@dataclass(frozen=True)
class GreySums:
    """Sums over pixels of (1, r, g, r^2, g^2, r g), r = f - g(x + u), from which all grey statistics follow.

    Attributes
    ----------
    values : (..., 6) float64 array
        Grey levels and their squares; the leading axes are cells, or nothing for a whole region.
    """

    values: Array

    @property
    def n_pixels(self) -> Array:
        """Number of pixels that count, (...,)."""
        return np.asarray(self.values[..., 0])

    def fit_gain_and_offset(self) -> tuple[Array, Array]:
        """Fit f = a g + b by least squares, (...,) each: a = 1 where g is flat, (1, 0) without pixels."""
        n, r, g, _, gg, rg = np.moveaxis(self.values, -1, 0)
        n = np.maximum(n, 1.0)
        variance = gg / n - (g / n) ** 2
        textured = ~find_flat(variance, gg / n)
        covariance = rg / n - r * g / n**2
        # Of f - g = (a - 1) g + b: the difference loses no digits where a is nearly 1.
        excess = np.where(textured, covariance / np.where(textured, variance, 1.0), 0.0)
        offset = np.where(self.n_pixels > 0, r / n - excess * g / n, 0.0)
        return 1.0 + excess, offset

    def sum_residual(self, gain: Array | float = 1.0, offset: Array | float = 0.0) -> tuple[Array, Array]:
        """Sum the residual f - gain g - offset and its square over the pixels, (...,) each.

        ``gain`` has no unit, ``offset`` is in grey levels; each is one number or (...,).
        """
        n, r, g, rr, gg, rg = np.moveaxis(self.values, -1, 0)
        e = np.asarray(gain) - 1.0
        b = np.asarray(offset)
        # r - e g - b, and its square multiplied out.
        first = r - e * g - b * n
        second = rr + e**2 * gg + b**2 * n - 2 * e * rg - 2 * b * r + 2 * e * b * g
        return first, np.maximum(second, 0.0)


def measure_deviation(n_pixels: float, first: Array, second: Array) -> tuple[float, float]:
    """Measure the standard deviation and the root mean square of grey levels from their sum and that of squares."""
    mean, mean_square = float(first) / n_pixels, float(second) / n_pixels
    # Rounding may leave a variance of nothing below zero.
    variance = max(mean_square - mean**2, 0.0)
    return float(np.sqrt(variance)), float(np.sqrt(mean_square))


@dataclass(frozen=True)
class GreyState:
    """Grey-level statistics of one camera's pixels of the whole region at one displacement.

    Attributes
    ----------
    residual_std, residual_rms : float
        Standard deviation and root mean square of the residual, grey levels.
    n_pixels : int
        Pixels that count.
    gain, offset : float
        Of f = gain g + offset, the global correction; 1 and 0 without it, and with the correction per element.
    """

    residual_std: float
    residual_rms: float
    n_pixels: int
    gain: float
    offset: float


FEW = 500
"""Values that are sorted as quickly as halved."""


def find_value_at(values: Array, weights: Array, left: float) -> float:
    """Find the one of the values, at least one, below which lies some weight, of all of them at most."""
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


def find_weighted_median(values: Array, weights: Array) -> float:
    """Find the one of the values, at least one, below which lies half of all weight; not all weights are 0."""
    return find_value_at(values, weights, 0.5 * weights.sum())
