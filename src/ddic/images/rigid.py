"""Rigid-body translation between two images by masked normalised cross-correlation (FFT)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

LEAST_OVERLAP = 0.5
"""Share of the region's pixels that a candidate translation must keep inside the deformed image. A larger one misses
large translations, a smaller one takes chance likeness of few pixels for one."""

ALIKE = 0.95
"""Share of the largest coefficient from which on another translation is as good: noise changes it by less."""

FLAT = 1e-9
"""Sum of squares about the mean, relative to the largest of all shifts, up to which an image is flat there: rounding
of the Fourier transforms leaves some 1e-13."""

_TINY = 1e-300
"""A sum of squares below any that is not 0."""


@dataclass(frozen=True)
class RigidShift:
    """A translation with g(x + shift) like f(x).

    Attributes
    ----------
    shift : (x, y)
        Pixels.
    coefficient : float
        Correlation coefficient of f and g there, 1 at most.
    n_alike : int
        Other translations, apart from this one, with nearly the same coefficient.
    """

    shift: tuple[float, float]
    coefficient: float
    n_alike: int = 0

    def scale(self, factor: float) -> RigidShift:
        """Scale the translation: of binned images, to pixels of the images themselves.

        Parameters
        ----------
        factor : float
            Pixels of the other images in one of these.

        Returns
        -------
        RigidShift
            With the same coefficient.
        """
        x, y = self.shift
        return replace(self, shift=(factor * x, factor * y))


def find_rigid_shift(f: NDArray[np.float64], g: NDArray[np.float64], region: NDArray[np.bool_]) -> RigidShift:
    """Find the translation of a region of f in g to sub-pixel accuracy.

    Parameters
    ----------
    f : (height, width) array
        Grey levels of the reference image.
    g : (height, width) array
        Grey levels of the deformed image.
    region : (height, width) array of bool
        Pixels of f that count.

    Returns
    -------
    RigidShift
        With the largest correlation coefficient.
    """
    weight = region.astype(np.float64)
    # Sums of squares of small numbers lose fewer digits.
    centre = f[region].mean()
    f, g = (f - centre) * weight, g - centre
    # Twice the size, or what leaves the image on one side would enter it on the other.
    shape = [fft.next_fast_len(2 * n, real=True) for n in f.shape]

    def correlate(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sums over pixels x of a(x) b(x + shift), for all shifts at once."""
        return np.asarray(fft.irfft2(np.conj(fft.rfft2(a, shape)) * fft.rfft2(b, shape), shape))

    # Of the region's pixels that a shift keeps in the deformed image: number, sums, sums of squares, of products.
    inside = np.ones_like(g)
    n = correlate(weight, inside)
    n_safe = np.maximum(n, 1.0)
    f_sum, g_sum = correlate(f, inside), correlate(weight, g)
    f_power = correlate(f**2, inside) - f_sum**2 / n_safe
    g_power = correlate(weight, g**2) - g_sum**2 / n_safe
    covariance = correlate(f, g) - f_sum * g_sum / n_safe
    floor = FLAT * max(float(f_power.max()), float(g_power.max()), _TINY)
    good = (n >= LEAST_OVERLAP * weight.sum()) & (f_power > floor) & (g_power > floor)
    coefficient = np.where(good, covariance / np.sqrt(np.where(good, f_power * g_power, 1.0)), -1.0)
    return _find_peak(coefficient)


def _find_peak(coefficient: NDArray[np.float64]) -> RigidShift:
    """The shift with the largest coefficient, refined along each axis; negative ones are at the array's ends."""
    height, width = coefficient.shape
    row, column = (int(k) for k in np.unravel_index(int(np.argmax(coefficient)), coefficient.shape))
    shift_y = _wrap(row, height) + _vertex(coefficient[:, column], row)
    shift_x = _wrap(column, width) + _vertex(coefficient[row], column)
    best = float(coefficient[row, column])
    # In the middle, where no peak lies across the ends of the array.
    centred = np.roll(coefficient > ALIKE * best, (height // 2 - row, width // 2 - column), axis=(0, 1))
    n_alike = int(ndimage.label(centred)[1]) - 1 if best > 0 else 0
    return RigidShift((shift_x, shift_y), best, n_alike)


def _wrap(index: int, size: int) -> int:
    """Where an index of a periodic sequence lies about 0."""
    return index - size if index > size // 2 else index


def _vertex(line: NDArray[np.float64], index: int) -> float:
    """Vertex of the parabola through a maximum and its neighbours, relative to it."""
    left, middle, right = line[index - 1], line[index], line[(index + 1) % len(line)]
    curvature = left - 2 * middle + right
    if curvature >= 0:
        return 0.0
    return float(np.clip(0.5 * (left - right) / curvature, -0.5, 0.5))
