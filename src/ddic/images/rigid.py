"""Rigid translation between two images by masked normalised cross-correlation (FFT); displacement on a regular grid."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from ddic.arrays import Array, BoolArray, IntArray

LEAST_OVERLAP = 0.5
"""Share of the region's pixels that a candidate translation must keep inside the deformed image. A larger one misses
large translations, a smaller one takes chance likeness of few pixels for one."""

ALIKE = 0.95
"""Share of the largest coefficient from which on another translation is as good: noise changes it by less."""

FLAT = 1e-9
"""Sum of squares about the mean, relative to the largest of all shifts, up to which an image is flat there: rounding
of the Fourier transforms leaves some 1e-13."""

SMOOTHED = {2: 0.0, 3: 0.8}
"""Standard deviation, pixels, by which images are smoothed before, by the number of dimensions: speckles as small as a
pixel look different half a pixel farther on, and in three directions leave a coefficient of 0.2."""

_TINY = 1e-300
"""A sum of squares below any that is not 0."""


@dataclass(frozen=True)
class RigidShift:
    """A translation with g(x + shift) like f(x).

    Attributes
    ----------
    shift : tuple of float
        Along x, y, and z in a volume, pixels.
    coefficient : float
        Correlation coefficient of f and g there, 1 at most.
    n_alike : int
        Other translations, apart from this one, with nearly the same coefficient.
    """

    shift: tuple[float, ...]
    coefficient: float
    n_alike: int = 0

    def describe(self) -> str:
        """Say how far it goes."""
        return f"({', '.join(f'{along:.2f}' for along in self.shift)}) px"

    def scale(self, factor: float) -> RigidShift:
        """Scale the translation of binned images by ``factor``, to pixels of the images themselves."""
        return replace(self, shift=tuple(factor * along for along in self.shift))


def find_rigid_shift(f: Array, g: Array, region: BoolArray) -> RigidShift:
    """Find the translation of a region of f in g, reference and deformed image, to sub-pixel accuracy.

    It has the largest correlation coefficient. The region is True on the pixels of f that count.
    """
    weight = region.astype(np.float64)
    # Sums of squares of small numbers lose fewer digits.
    centre = f[region].mean()
    f, g = f - centre, g - centre
    if SMOOTHED[f.ndim]:
        f, g = (scipy.ndimage.gaussian_filter(values, SMOOTHED[f.ndim]) for values in (f, g))
    f *= weight
    return _find_peak(_correlate_coefficients(f, g, weight))


def _correlate_coefficients(f: Array, g: Array, weight: Array) -> Array:
    """Correlation coefficients of the region, where ``weight`` is 1 and f not 0, for all shifts; -1 where none is."""
    # Twice the size, or what leaves the image on one side would enter it on the other.
    shape = tuple(scipy.fft.next_fast_len(2 * n, real=True) for n in f.shape)
    spectrum_of_weight, spectrum_of_f = (np.conj(scipy.fft.rfftn(a, shape)) for a in (weight, f))
    spectrum_of_g = scipy.fft.rfftn(g, shape)

    def sum_products(first: NDArray[np.complex128], second: NDArray[np.complex128]) -> Array:
        return np.asarray(scipy.fft.irfftn(first * second, shape, overwrite_x=True))

    # Of the region's pixels that a shift keeps in the deformed image: number, sums, sums of squares, of products.
    n, f_sum, f_power = (_sum_kept(a, shape) for a in (weight, f, f**2))
    n_safe = np.maximum(n, 1.0)
    g_sum = sum_products(spectrum_of_weight, spectrum_of_g)
    covariance = sum_products(spectrum_of_f, spectrum_of_g) - f_sum * g_sum / n_safe
    f_power -= f_sum**2 / n_safe
    g_power = sum_products(spectrum_of_weight, scipy.fft.rfftn(g**2, shape)) - g_sum**2 / n_safe
    floor = FLAT * max(float(f_power.max()), float(g_power.max()), _TINY)
    good = (n >= LEAST_OVERLAP * weight.sum()) & (f_power > floor) & (g_power > floor)
    return np.where(good, covariance / np.sqrt(np.where(good, f_power * g_power, 1.0)), -1.0)


def _sum_kept(values: Array, shape: tuple[int, ...]) -> Array:
    """Sums of the values at the pixels that a shift keeps in an image of the same size, for all shifts."""
    # What a shift keeps is a box, so that cumulative sums do, which take a fifth of three Fourier transforms.
    for axis, n_shifts in enumerate(shape):
        values = np.moveaxis(_sum_kept_rows(np.moveaxis(values, axis, 0), n_shifts), 0, axis)
    return np.ascontiguousarray(values)


def _sum_kept_rows(values: Array, n_shifts: int) -> Array:
    """The same along the first axis, shifts counted as by ``_wrap``."""
    height = len(values)
    shifts = np.arange(n_shifts)
    shifts[shifts > n_shifts // 2] -= n_shifts
    up_to = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
    return np.asarray(up_to[np.clip(height - shifts, 0, height)] - up_to[np.clip(-shifts, 0, height)])


def _find_peak(coefficient: Array) -> RigidShift:
    """The shift with the largest coefficient, refined along each axis; negative ones are at the array's ends."""
    shape = coefficient.shape
    place = tuple(int(k) for k in np.unravel_index(int(np.argmax(coefficient)), shape))
    shifts = []
    for axis, (index, size) in enumerate(zip(place, shape, strict=True)):
        line = np.moveaxis(coefficient, axis, -1)[place[:axis] + place[axis + 1:]]
        shifts.append(_wrap(index, size) + _vertex(line, index))
    best = float(coefficient[place])
    # In the middle, where no peak lies across the ends of the array.
    to_middle = tuple(size // 2 - index for index, size in zip(place, shape, strict=True))
    alike = np.roll(coefficient > ALIKE * best, to_middle, axis=tuple(range(len(shape))))
    n_pieces = (cv2.connectedComponents(alike.astype(np.uint8), connectivity=4)[0] - 1 if alike.ndim == 2
                else scipy.ndimage.label(alike)[1])
    # Without the piece around the largest.
    return RigidShift(tuple(shifts[::-1]), best, n_pieces - 1 if best > 0 else 0)


def _wrap(index: int, size: int) -> int:
    """Where an index of a periodic sequence lies about 0."""
    return index - size if index > size // 2 else index


def _vertex(line: Array, index: int) -> float:
    """Vertex of the parabola through a maximum and its neighbours, relative to it."""
    left, middle, right = line[index - 1], line[index], line[(index + 1) % len(line)]
    curvature = left - 2 * middle + right
    if curvature >= 0:
        return 0.0
    return float(np.clip(0.5 * (left - right) / curvature, -0.5, 0.5))


@dataclass(frozen=True)
class GridField:
    """Displacement on a regular grid.

    Attributes
    ----------
    origin, spacing : tuple of float
        Position of the first node, and distances between neighbours, along x, y, and z in a volume, pixels.
    values : (rows, columns, 2) or (planes, rows, columns, 3) array
        Displacement, pixels.
    """

    origin: tuple[float, ...]
    spacing: tuple[float, ...]
    values: Array

    def at(self, points: Array) -> Array:
        """Interpolate between the grid's nodes at points, (n, dim), pixels, linearly; constant beyond its edge."""
        # scipy.ndimage does the same, and takes more to import than most starts take to interpolate.
        dim = points.shape[1]
        last = np.array(self.values.shape[:dim][::-1]) - 1
        place = np.clip((points - np.asarray(self.origin)) / np.asarray(self.spacing), 0, last)
        low = np.minimum(place.astype(np.int64), np.maximum(last - 1, 0))
        ends, shares = (low.T, np.minimum(low + 1, last).T), (place - low).T[:, :, None]

        def interpolate(axis: int, *chosen: IntArray) -> Array:
            if axis < 0:
                return np.asarray(self.values[chosen])
            before, after = (interpolate(axis - 1, *chosen, end[axis]) for end in ends)
            return np.asarray((1.0 - shares[axis]) * before + shares[axis] * after)

        return interpolate(dim - 1)


def build_uniform_field(shift: tuple[float, ...]) -> GridField:
    """Return a rigid translation, pixels, as a field of one node."""
    dim = len(shift)
    return GridField((0.0,) * dim, (1.0,) * dim, np.array(shift, dtype=np.float64).reshape(*[1] * dim, dim))


def fill_absent(values: Array) -> Array:
    """Give places of a grid, (..., dim), that are nan the value of the nearest that is not, if there is any."""
    absent = np.isnan(values).any(axis=-1)
    if not absent.any():
        return values
    nearest = scipy.ndimage.distance_transform_edt(absent, return_distances=False, return_indices=True)
    return np.asarray(values[tuple(nearest)])
