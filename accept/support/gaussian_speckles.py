"""A speckle texture of its own: Gaussians drawn in a rectangle, summed at any point, nothing interpolated.

The acceptance tables that judge clean pairs draw with it, so that what the product's own renderer and the product have
in common cannot hide an error of either.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DENSITY = 0.08
"""Speckles per square pixel, at the reference size."""

SIGMA, AMPLITUDE = (1.3, 1.6), (0.5, 1.0)
"""Standard deviation of a speckle at the reference size, pixels, and its height: uniform between these."""

TAIL = 18.0
"""Exponent at which a speckle ends: all tails together are below 1e-7."""

DEVIATION = 0.6
"""Standard deviation of the centred sum whose hyperbolic tangent is the grey level."""


@dataclass(frozen=True, eq=False)
class Speckles:
    """Speckles in square bins, row by row.

    Attributes
    ----------
    drawn : (n, 4) array
        Column and row of the centre, pixels, height, and 1 / (2 sigma^2); sorted by bin.
    starts : (n_rows * n_columns + 1,) array of int64
        First speckle of each bin.
    origin : (2,) array
        Column and row where the first bin begins, pixels.
    n_rows, n_columns : int
        Of bins.
    bin_side : float
        As far as a speckle reaches, pixels: a point sees its own bin and those around it.
    size : float
        Of the speckles, times the reference size.
    """

    drawn: Array
    starts: NDArray[np.int64]
    origin: Array
    n_rows: int
    n_columns: int
    bin_side: float
    size: float

    def sum_at(self, points: Array) -> Array:
        """Sum of the Gaussians at points (n, 2), (n,)."""
        return np.asarray(sum_speckles(points, self.drawn, self.starts, (self.n_rows, self.n_columns),
                                       (self.origin[0], self.origin[1], self.bin_side)))

    def grey(self, points: Array) -> Array:
        """Grey levels 255 (0.5 - 0.45 tanh s) at points (n, 2), not yet rounded, (n,)."""
        mean, deviation = find_moments(self.size)
        centred = (self.sum_at(points) - mean) * (DEVIATION / deviation)
        return np.asarray(255.0 * (0.5 - 0.45 * np.tanh(centred)))


def find_moments(size: float) -> tuple[float, float]:
    """Find mean and standard deviation of the sum of Gaussians over the plane (Campbell's theorem).

    Parameters
    ----------
    size : float
        Of the speckles, times the reference size, which neither depends on.

    Returns
    -------
    mean, deviation : float
        No unit.
    """
    density = DENSITY / size**2
    low, high = SIGMA[0] * size, SIGMA[1] * size
    mean_square_sigma = (low**2 + low * high + high**2) / 3
    mean_amplitude = sum(AMPLITUDE) / 2
    mean_square_amplitude = (AMPLITUDE[0]**2 + AMPLITUDE[0] * AMPLITUDE[1] + AMPLITUDE[1]**2) / 3
    mean = density * mean_amplitude * 2 * math.pi * mean_square_sigma
    variance = density * mean_square_amplitude * math.pi * mean_square_sigma
    return mean, math.sqrt(variance)


def draw_speckles(low: Array, high: Array, size: float, seed: int) -> Speckles:
    """Draw speckles that cover a rectangle.

    Parameters
    ----------
    low, high : (2,) array
        Its first and last column and row, pixels.
    size : float
        Of the speckles, times the reference size.
    seed : int
        Of the draw.

    Returns
    -------
    Speckles
        Also those beyond the rectangle that reach into it.
    """
    reach = math.sqrt(2 * TAIL) * SIGMA[1] * size
    # A bin more on each side holds what reaches in.
    origin = np.asarray(low) - reach
    n_columns, n_rows = (math.ceil(length / reach) + 1 for length in np.asarray(high) + reach - origin)
    random = np.random.default_rng(seed)
    extent = reach * np.array([n_columns, n_rows])
    n_speckles = random.poisson(DENSITY / size**2 * extent.prod())
    centres = origin + random.random((n_speckles, 2)) * extent
    sigma = size * random.uniform(*SIGMA, n_speckles)
    drawn = np.column_stack([centres, random.uniform(*AMPLITUDE, n_speckles), 0.5 / sigma**2])
    column, row = np.floor((centres - origin) / reach).astype(np.int64).T
    of_bin = row * n_columns + column
    starts = np.zeros(n_rows * n_columns + 1, dtype=np.int64)
    starts[1:] = np.cumsum(np.bincount(of_bin, minlength=n_rows * n_columns))
    return Speckles(drawn[np.argsort(of_bin, kind="stable")], starts, origin, n_rows, n_columns, reach, size)


def _sum_speckles_py(points: Array, drawn: Array, starts: NDArray[np.int64], n_bins: tuple[int, int],
                     bins: tuple[float, float, float]) -> Array:
    """Sum at points (n, 2) of the speckles in their bins and the eight around these; bins: origin and side."""
    n_rows, n_columns = n_bins
    x0, y0, side = bins
    sums = np.zeros(len(points))
    for k in range(len(points)):
        x, y = points[k, 0], points[k, 1]
        column, row = math.floor((x - x0) / side), math.floor((y - y0) / side)
        total = 0.0
        for i in range(max(row - 1, 0), min(row + 2, n_rows)):
            for j in range(max(column - 1, 0), min(column + 2, n_columns)):
                for s in range(starts[i * n_columns + j], starts[i * n_columns + j + 1]):
                    exponent = ((x - drawn[s, 0])**2 + (y - drawn[s, 1])**2) * drawn[s, 3]
                    if exponent < TAIL:
                        total += drawn[s, 2] * math.exp(-exponent)
        sums[k] = total
    return sums


sum_speckles = numba.njit(cache=True)(_sum_speckles_py)
