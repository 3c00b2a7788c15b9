"""Displacement fields of clean pairs, smooth wherever the images show them, and a speckle texture of its own.

Gaussians drawn in a rectangle are summed at any point, nothing is interpolated: what the product's own renderer and the
product have in common cannot hide an error of either.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from ddic.fracture.crack_tip import evaluate_williams_series, find_kolosov_constant
from ddic.mesh.rotation import build_rotation
from ddic.synth.fields import Kirsch

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
    """Find mean and standard deviation of the sum of Gaussians over the plane (Campbell's theorem)."""
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


Motion = Callable[[Array], Array]
"""Displacement (n, 2) at points (n, 2), pixels."""

ROTATION_DEGREES = 10.0
TRANSLATION = np.array([3.3, -5.6])

CRACK_ABOVE = 50.0
"""Distance of the crack's line from the image's first row, pixels: no image shows the crack."""

INVERSE_PX, MOST_STEPS = 1e-11, 200
"""Where the search for the points that a motion came from ends."""


def make_waves(wavelength: float, strain: float) -> Motion:
    """Make two crossed waves.

    Parameters
    ----------
    wavelength : float
        The shorter, pixels.
    strain : float
        Largest, along x.

    Returns
    -------
    callable
        The displacement.
    """
    amplitude = strain * wavelength / (2 * np.pi)
    short, long = 2 * np.pi / wavelength, 2 * np.pi / (1.25 * wavelength)

    def displacement(points: Array) -> Array:
        x, y = points.T
        along_x = np.sin(short * x + 0.3) * np.cos(long * y - 0.2)
        along_y = np.cos(long * x - 0.7) * np.sin(short * y + 0.5)
        return np.asarray(amplitude * np.column_stack([along_x, 0.8 * along_y]))

    return displacement


def make_hole(centre: Array, radius: float, strain: float) -> Motion:
    """Make a plate with a hole in tension.

    Parameters
    ----------
    centre : (2,) array
        Of the hole, pixels.
    radius : float
        Pixels.
    strain : float
        Far from the hole, along y.

    Returns
    -------
    callable
        The displacement, continued smoothly into the hole.
    """
    return Kirsch((centre[0], centre[1]), radius, strain, 0.3, (TRANSLATION[0], TRANSLATION[1])).displacement


def make_crack(tip_column: float, opening: float) -> Motion:
    """Make the field beside and ahead of a crack that runs along x above the image.

    Parameters
    ----------
    tip_column : float
        Pixels.
    opening : float
        K_I over the shear modulus, half of which is K_II's, px^(1/2).

    Returns
    -------
    callable
        The displacement.
    """
    tip = np.array([tip_column, -CRACK_ABOVE])
    coefficients = opening / (2 * np.sqrt(2 * np.pi)) * np.array([1.0, -0.5])
    kappa = find_kolosov_constant(0.3, "stress")

    def displacement(points: Array) -> Array:
        terms = evaluate_williams_series(points - tip, np.array([1]), kappa)
        return np.asarray(terms @ coefficients)

    return displacement


def make_neck(centre: Array, width: float, strain: float) -> Motion:
    """Make a strain of 1 % along y with a Gaussian neck.

    Parameters
    ----------
    centre : (2,) array
        Pixels.
    width : float
        Standard deviation of the neck, pixels.
    strain : float
        Added in its middle.

    Returns
    -------
    callable
        The displacement, narrower by 0.4 of the strain.
    """

    def displacement(points: Array) -> Array:
        x, y = (points - centre).T
        neck = strain * np.exp(-(y**2) / (2 * width**2))
        stretch = strain * width * np.sqrt(np.pi / 2) * erf(y / (np.sqrt(2) * width))
        return np.column_stack([-0.4 * (0.01 + neck) * x, 0.01 * y + stretch])

    return displacement


def make_turned_waves(centre: Array, wavelength: float, strain: float) -> Motion:
    """Make a rotation with waves on top.

    Parameters
    ----------
    centre : (2,) array
        Of the rotation, pixels.
    wavelength, strain : float
        Of the waves.

    Returns
    -------
    callable
        The displacement.
    """
    turn = build_rotation(np.deg2rad(ROTATION_DEGREES)) - np.eye(2)
    waves = make_waves(wavelength, strain)
    return lambda points: np.asarray((points - centre) @ turn.T + waves(points))


def find_origins(motion: Motion, points: Array) -> Array:
    """Find x with x + u(x) = y by the fixed point x = y - u(x), for gradients well below 1.

    Parameters
    ----------
    motion : callable
        u.
    points : (n, 2) array
        The y, pixels.

    Returns
    -------
    (n, 2) array
        The x, pixels.

    Raises
    ------
    ValueError
        Where it does not come to rest.
    """
    origins = points - motion(points)
    for _ in range(MOST_STEPS):
        nearer = points - motion(origins)
        step = float(np.abs(nearer - origins).max())
        origins = nearer
        if step <= INVERSE_PX:
            return origins
    raise ValueError(f"the motion could not be inverted: the last step was {step:.1e} px")
