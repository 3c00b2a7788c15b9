"""How large the features of a pattern are."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ddic.images.source import ImageSource
from ddic.images.window import Window

SIDE = 128
"""Pixels along each side of a window that is looked at; features above a quarter of it are not told."""

HALF = 0.5
"""Correlation at the edge of a feature: the guides' width at half of the maximum."""


def measure_feature_size(source: ImageSource, places: NDArray[np.float64]) -> float:
    """Measure the size of a pattern's features: the width of the autocorrelation at half of its maximum.

    Parameters
    ----------
    source : ImageSource
        The image.
    places : (n, 2) array
        Middles of windows of 128 x 128 px that are looked at, pixels: some on the specimen, for edges and holes in a
        few of them change little.

    Returns
    -------
    float
        Median over the windows and the two axes, pixels; nan where no window has features that end in it.
    """
    widths = [width for x, y in places for width in _measure_window(source, float(x), float(y))]
    known = [width for width in widths if math.isfinite(width)]
    return float(np.median(known)) if known else math.nan


def _measure_window(source: ImageSource, x: float, y: float) -> list[float]:
    """Widths along x and y about a place."""
    grey = np.nan_to_num(np.asarray(source.read(_place_window(source, x, y)), np.float64))
    grey = (grey - grey.mean()) * np.hanning(grey.shape[0])[:, None] * np.hanning(grey.shape[1])
    correlation = np.fft.irfft2(np.abs(np.fft.rfft2(grey))**2, s=grey.shape)
    if not correlation[0, 0] > 0:
        return []
    return [2.0 * _find_half(line / line[0]) for line in (correlation[0], correlation[:, 0])]


def _place_window(source: ImageSource, x: float, y: float) -> Window:
    """A window about a place, moved into the image."""
    corners = []
    for middle, side in ((x, source.width), (y, source.height)):
        size = min(side, SIDE)
        begin = int(np.clip(round(middle - 0.5 * size), 0, side - size))
        corners.append((begin, begin + size))
    (x0, x1), (y0, y1) = corners
    return Window(x0, y0, x1, y1)


def _find_half(line: NDArray[np.float64]) -> float:
    """Where a correlation falls below a half first, between pixels; nan where it does not in a quarter of it."""
    below = np.flatnonzero(line[:len(line) // 4 + 1] < HALF)
    if not below.size:
        return math.nan
    k = int(below[0])
    return float(k - 1 + (line[k - 1] - HALF) / (line[k - 1] - line[k]))
