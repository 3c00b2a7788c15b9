"""Rigid-body translation between two images by masked normalised cross-correlation (FFT)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

LEAST_OVERLAP = 0.5
"""Share of the region's pixels that a candidate translation must keep inside the deformed image."""


@dataclass(frozen=True)
class RigidShift:
    """A translation with g(x + shift) like f(x).

    Attributes
    ----------
    shift : (x, y)
        Pixels.
    coefficient : float
        Correlation coefficient of f and g there, 1 at most.
    """

    shift: tuple[float, float]
    coefficient: float


def rigid_shift(f: NDArray[np.float64], g: NDArray[np.float64], region: NDArray[np.bool_]) -> RigidShift:
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
    m = region.astype(np.float64)
    centre = f[region].mean()
    f, g = (f - centre) * m, g - centre
    shape = [fft.next_fast_len(2 * n, real=True) for n in f.shape]

    def correlate(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(fft.irfft2(np.conj(fft.rfft2(a, shape)) * fft.rfft2(b, shape), shape))

    inside = np.ones_like(g)
    n = correlate(m, inside)
    n_safe = np.maximum(n, 1.0)
    f_sum, g_sum = correlate(f, inside), correlate(m, g)
    f_power = correlate(f**2, inside) - f_sum**2 / n_safe
    g_power = correlate(m, g**2) - g_sum**2 / n_safe
    covariance = correlate(f, g) - f_sum * g_sum / n_safe
    floor = 1e-9 * max(float(f_power.max()), float(g_power.max()), 1e-300)
    good = (n >= LEAST_OVERLAP * m.sum()) & (f_power > floor) & (g_power > floor)
    coefficient = np.where(good, covariance / np.sqrt(np.where(good, f_power * g_power, 1.0)), -1.0)
    row, column = np.unravel_index(int(np.argmax(coefficient)), coefficient.shape)
    shift_y = _wrapped(int(row), shape[0]) + _peak(coefficient[:, column], int(row))
    shift_x = _wrapped(int(column), shape[1]) + _peak(coefficient[row], int(column))
    return RigidShift((shift_x, shift_y), float(coefficient[row, column]))


def _wrapped(index: int, size: int) -> int:
    return index - size if index > size // 2 else index


def _peak(line: NDArray[np.float64], index: int) -> float:
    """Vertex of the parabola through a maximum and its neighbours, relative to it."""
    left, middle, right = line[index - 1], line[index], line[(index + 1) % len(line)]
    curvature = left - 2 * middle + right
    if curvature >= 0:
        return 0.0
    return float(np.clip(0.5 * (left - right) / curvature, -0.5, 0.5))
