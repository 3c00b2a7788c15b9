"""Prefiltered B-spline images, read window by window."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ddic.images.source import ImageSource
from ddic.images.window import Window

HALO = {3: 28, 5: 44}
"""Pixels after which the recursive prefilter of each degree has decayed below 1e-16 (poles -0.268, -0.431)."""

PADDING = {3: 2, 5: 3}
"""Coefficients needed beyond the outermost pixel at which the spline is evaluated."""

_VALUE_TAPS = {3: np.array([1.0, 4.0, 1.0]) / 6.0, 5: np.array([1.0, 26.0, 66.0, 26.0, 1.0]) / 120.0}
_SLOPE_TAPS = {3: np.array([-1.0, 0.0, 1.0]) / 2.0, 5: np.array([-1.0, -10.0, 0.0, 10.0, 1.0]) / 24.0}

_BAND_ROWS = 512


@dataclass(frozen=True)
class SplineImage:
    """Spline coefficients of a window of an image.

    coefficients: float32, (window.height + 2 PADDING, window.width + 2 PADDING); entry [PADDING, PADDING]
    belongs to pixel (window.x0, window.y0). Beyond the image's edge they continue by reflection.
    usable: uint8 of the window's shape, 0 where the pixel or its right, lower or lower right neighbour
    is excluded; None where nothing is excluded.
    """

    window: Window
    degree: int
    coefficients: NDArray[np.float32]
    usable: NDArray[np.uint8] | None = None


@dataclass(frozen=True)
class GradientImage:
    """Grey levels and spline gradient of a window of the reference image.

    values, by_x, by_y: float32 of the window's shape, grey levels and grey levels per pixel.
    usable: uint8 of the window's shape, 0 where the pixel is excluded; None where nothing is excluded.
    """

    window: Window
    values: NDArray[np.float32]
    by_x: NDArray[np.float32]
    by_y: NDArray[np.float32]
    usable: NDArray[np.uint8] | None = None


def spline_coefficients(values: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    """Prefilter an image (height, width) for B-spline interpolation with reflection at its edges."""
    return np.asarray(ndimage.spline_filter(values, order=degree, output=np.float64, mode="mirror"))


def read_spline(source: ImageSource, window: Window, degree: int,
                usable: NDArray[np.uint8] | None = None) -> SplineImage:
    """Read a window (inside the image) and prefilter it; coefficients equal the whole image's to 1e-16."""
    pad = PADDING[degree]
    out = np.empty((window.height + 2 * pad, window.width + 2 * pad), dtype=np.float32)
    inner = window.grown(pad).clipped(source.width, source.height)
    held = _hold(source, inner, degree)
    for band, coefficients in _coefficient_bands(held, inner, degree):
        y = band.y0 - (window.y0 - pad)
        x = inner.x0 - (window.x0 - pad)
        out[y: y + band.height, x: x + inner.width] = coefficients
    _reflect(out, inner, window.grown(pad))
    return SplineImage(window, degree, out, None if usable is None else _erode(usable))


def read_gradient(source: ImageSource, window: Window, degree: int,
                  usable: NDArray[np.uint8] | None = None) -> GradientImage:
    """Read a window (inside the image) with its spline gradient at pixel centres."""
    shape = (window.height, window.width)
    values, by_x, by_y = (np.empty(shape, dtype=np.float32) for _ in range(3))
    pad = PADDING[degree]
    held = _hold(source, window.grown(pad), degree)
    for band in _bands(window):
        wide = band.grown(pad).clipped(source.width, source.height)
        coefficients = np.concatenate([c for _, c in _coefficient_bands(held, wide, degree)])
        gx = _filter(coefficients, _VALUE_TAPS[degree], _SLOPE_TAPS[degree])
        gy = _filter(coefficients, _SLOPE_TAPS[degree], _VALUE_TAPS[degree])
        rows = slice(band.y0 - window.y0, band.y1 - window.y0)
        inner = np.s_[band.y0 - wide.y0: band.y1 - wide.y0, band.x0 - wide.x0: band.x1 - wide.x0]
        by_x[rows], by_y[rows] = gx[inner], gy[inner]
        values[rows] = held.read(band)
    return GradientImage(window, values, by_x, by_y, usable)


def _filter(coefficients: NDArray[np.float64], taps_y: NDArray[np.float64],
            taps_x: NDArray[np.float64]) -> NDArray[np.float64]:
    along_y = ndimage.correlate1d(coefficients, taps_y, axis=0, mode="mirror")
    return np.asarray(ndimage.correlate1d(along_y, taps_x, axis=1, mode="mirror"))


@dataclass(frozen=True)
class _Held:
    """A part of an image in memory, in its own type: a file is read, or decoded, once per window."""

    window: Window
    extent: Window
    pixels: NDArray[Any]

    def read(self, window: Window) -> NDArray[np.float64]:
        inside = self.pixels[window.y0 - self.window.y0: window.y1 - self.window.y0,
                             window.x0 - self.window.x0: window.x1 - self.window.x0]
        return inside.astype(np.float64)


def _hold(source: ImageSource, window: Window, degree: int) -> _Held:
    wide = window.grown(HALO[degree]).clipped(source.width, source.height)
    return _Held(wide, Window(0, 0, source.width, source.height), _finite(source.read(wide)))


def _finite(pixels: NDArray[Any]) -> NDArray[Any]:
    """Give pixels that are not finite the nearest finite value.

    Only masked pixels can be so (the check of the inputs refuses others); a jump there would ring into
    the gradient of their neighbours, which count.
    """
    if np.issubdtype(pixels.dtype, np.integer):
        return pixels
    absent = ~np.isfinite(pixels)
    if not absent.any() or absent.all():
        return np.nan_to_num(pixels, nan=0.0, posinf=0.0, neginf=0.0)
    nearest = ndimage.distance_transform_edt(absent, return_distances=False, return_indices=True)
    return np.asarray(pixels[tuple(nearest)])


def _bands(window: Window) -> Iterator[Window]:
    for y0 in range(window.y0, window.y1, _BAND_ROWS):
        yield Window(window.x0, y0, window.x1, min(y0 + _BAND_ROWS, window.y1))


def _coefficient_bands(held: _Held, window: Window,
                       degree: int) -> Iterator[tuple[Window, NDArray[np.float64]]]:
    for band in _bands(window):
        wide = band.grown(HALO[degree]).intersection(held.extent)
        coefficients = spline_coefficients(held.read(wide), degree)
        yield band, coefficients[band.y0 - wide.y0: band.y1 - wide.y0, band.x0 - wide.x0: band.x1 - wide.x0]


def _reflect(out: NDArray[np.float32], filled: Window, whole: Window) -> None:
    top, left = filled.y0 - whole.y0, filled.x0 - whole.x0
    bottom, right = top + filled.height - 1, left + filled.width - 1
    for k in range(1, top + 1):
        out[top - k] = out[top + k]
    for k in range(1, len(out) - bottom):
        out[bottom + k] = out[bottom - k]
    for k in range(1, left + 1):
        out[:, left - k] = out[:, left + k]
    for k in range(1, out.shape[1] - right):
        out[:, right + k] = out[:, right - k]


def _erode(usable: NDArray[np.uint8]) -> NDArray[np.uint8]:
    eroded = usable.copy()
    eroded[:, :-1] &= usable[:, 1:]
    eroded[:-1] &= usable[1:]
    eroded[:-1, :-1] &= usable[1:, 1:]
    return eroded
