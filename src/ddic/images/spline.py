"""Prefiltered B-spline images, read window by window."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, BoolArray
from ddic.images.prefilter import TURNED, prefilter, prefilter_columns, write_column_slopes, write_row_slopes
from ddic.images.source import ImageSource, fill_excluded, without_cross, without_neighbours
from ddic.images.threads import ONE_THREAD, Threads
from ddic.images.window import Window

HALO = {3: 28, 5: 44}
"""Pixels after which the recursive prefilter of each degree has decayed below 1e-16 (poles -0.268, -0.431)."""

PADDING = {3: 2, 5: 3}
"""Coefficients needed beyond the outermost pixel at which the spline is evaluated."""

FindUsable = Callable[[Window], NDArray[np.uint8] | None]
"""Gives the pixels of a window that count: 0 where one is excluded, None where nothing can be."""

BYTES_FROM = 1 << 24
"""Pixels of an image of bytes from which on its grey levels stay bytes: a smaller one would not be worth the kernels
that are loaded for them beside those for float32, which coarse images need."""

_BAND_ROWS = 512
_BLOCK = 2**17
"""Pixels whose rows are filtered together, in float64 as much as the second-level cache holds."""


@dataclass(frozen=True)
class SplineImage:
    """Spline coefficients of a window of an image.

    Attributes
    ----------
    window : Window
        Its pixels.
    degree : int
        Of the spline, 3 or 5.
    coefficients : array of the window's shape, PADDING more on every side
        Beyond the image's edge they continue by reflection. Those of a volume of bytes are int16.
    usable : array of the window's shape, or None
        0 where a value between the pixel and the next one along each axis is interpolated from an excluded pixel; None
        where nothing is excluded.
    scale, offset : float
        Grey levels are scale times the spline of the coefficients, plus offset; 1 and 0 but for int16.
    """

    window: Window
    degree: int
    coefficients: NDArray[Any]
    usable: NDArray[np.uint8] | None = None
    scale: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class GradientImage:
    """Grey levels and spline gradient of a window of the reference image.

    Attributes
    ----------
    window : Window
        Its pixels.
    values : array of the window's shape, ``margin`` more on every side
        Grey levels: bytes of a large image that has bytes, else float32; a volume's in its own type where kernels know
        it.
    slopes : (2, window.height, window.width) array
        Of the spline at pixel centres, along x and along y, grey levels per pixel. Of a volume, whose gradient kernels
        take by differences, the grey levels that they take it from, as ``values`` but for ``correct_light``, (1, ...):
        three numbers a voxel are too many.
    usable : array of the window's shape, or None
        0 where the pixel is excluded, or one that its slope is taken from; None where nothing is.
    margin : int
        Pixels beyond the window that the gradient is taken from; 0 where it is there.
    """

    window: Window
    values: NDArray[Any]
    slopes: NDArray[Any]
    usable: NDArray[np.uint8] | None = None
    margin: int = 0

    @property
    def grey_levels(self) -> NDArray[Any]:
        """Grey levels of the window alone."""
        return self.values[self.window.grow(self.margin).locate(self.window)]

    def restrict(self, window: Window) -> GradientImage:
        """Look into a window inside it: the new arrays look into these; only what is excluded is copied."""
        with_margin = self.window.grow(self.margin).locate(window.grow(self.margin))
        usable = None if self.usable is None else self.usable[self.window.locate(window)].copy()
        return GradientImage(window, self.values[with_margin], self.slopes[:, *with_margin], usable, self.margin)

    def correct_light(self, light: NDArray[np.float32]) -> GradientImage:
        """Subtract grey levels of the window that vary so slowly that slopes do not know them.

        The result has arrays of its own: kernels step through both alike.
        """
        return replace(self, values=self.values - np.pad(light, self.margin), slopes=self.slopes.astype(np.float32))

    def exclude(self, excluded: BoolArray) -> GradientImage:
        """Exclude further pixels, in a new array that says what is usable."""
        usable = np.asarray(~excluded, dtype=np.uint8)
        return replace(self, usable=usable if self.usable is None else usable & self.usable)


def compute_coefficients(values: Array, degree: int) -> Array:
    """Prefilter an image for B-spline interpolation of degree 3 or 5, with reflection at its edges."""
    coefficients = np.array(values, dtype=np.float64, order="C")
    prefilter(coefficients, degree)
    return coefficients


def read_spline(source: ImageSource, window: Window, degree: int, find_usable: FindUsable | None = None,
                threads: Threads = ONE_THREAD, *, excludes_taps: bool = True) -> SplineImage:
    """Read a window inside the image and prefilter it; its coefficients equal the whole image's to 1e-16.

    ``find_usable`` gives the pixels of a window that count, as ``MaskedSource.find_usable``; all do where it is left
    out. With ``excludes_taps`` all that is interpolated from an excluded pixel is left out, otherwise only what lies
    beside it.
    """
    whole = window.grow(PADDING[degree])
    out = np.empty(whole.shape, dtype=np.float32)
    inner = whole.intersection(source.extent)
    halo = HALO[degree]
    held = _hold(source, inner, halo, find_usable)

    def fill(bands: Iterator[Window]) -> None:
        buffer = held.buffer(_BAND_ROWS + 2 * halo)
        for band in bands:
            wide = band.grow(halo).intersection(held.window)
            coefficients = held.read(wide, buffer)
            prefilter(coefficients, degree)
            out[whole.locate(band)] = coefficients[wide.locate(band)]

    # The same bands for any number of threads: the halo's remainder, and with it rounding, depends on them.
    threads.share(inner.split_rows(_BAND_ROWS), fill)
    _reflect(out, inner, whole)
    reach = degree // 2 if excludes_taps else 0
    usable = None if held.usable is None else without_neighbours(held.usable, reach, reach + 1)
    return SplineImage(window, degree, out, held.restrict_usable(usable, window))


def read_gradient(source: ImageSource, window: Window, degree: int, find_usable: FindUsable | None = None,
                  threads: Threads = ONE_THREAD, *, excludes_taps: bool = True) -> GradientImage:
    """Read a window inside the image with its spline gradient at pixel centres.

    A slope along x needs coefficients along x alone: the values of the spline at pixel centres of a column undo the
    prefilter along columns. ``find_usable`` is as for ``read_spline``. With ``excludes_taps`` the pixels whose slope is
    taken from an excluded one are left out, otherwise only the excluded ones.
    """
    halo = HALO[degree] + PADDING[degree]
    held = _hold(source, window, halo, find_usable)
    keeps_bytes = held.pixels.dtype == np.uint8 and source.extent.n_pixels >= BYTES_FROM
    grey_type = np.uint8 if keeps_bytes else np.float32
    values: NDArray[np.float32 | np.uint8] = np.empty(window.shape, dtype=grey_type)
    slopes = np.empty((2, *window.shape), dtype=np.float32)
    wide = held.window
    n_rows = max(_BLOCK // wide.width, TURNED)

    def along_x(blocks: Iterator[Window]) -> None:
        buffer = held.buffer(n_rows)
        for rows in blocks:
            block = held.read(wide.take_rows(rows.y0, rows.y1), buffer)
            write_row_slopes(block, window.x0 - wide.x0, degree, slopes[0, rows.y0 - window.y0: rows.y1 - window.y0])

    def along_y(bands: Iterator[Window]) -> None:
        buffer = held.buffer(_BAND_ROWS + 2 * halo)
        for band in bands:
            place = slice(band.y0 - window.y0, band.y1 - window.y0)
            top, bottom = max(band.y0 - halo, wide.y0), min(band.y1 + halo, wide.y1)
            block = held.read(window.take_rows(top, bottom), buffer)
            prefilter_columns(block, degree)
            write_column_slopes(block, band.y0 - top, degree, slopes[1, place])
            values[place] = held.restrict(band)

    threads.share(window.split_rows(n_rows), along_x)
    threads.share(window.split_rows(_BAND_ROWS), along_y)
    reach = degree // 2 if excludes_taps else 0
    usable = None if held.usable is None else without_cross(held.usable, reach)
    return GradientImage(window, values, slopes, held.restrict_usable(usable, window))


@dataclass(frozen=True)
class _Held:
    """A part of an image in memory, in its own type, excluded pixels filled: a file is read once per window."""

    window: Window
    pixels: NDArray[Any]
    usable: NDArray[np.uint8] | None

    def restrict(self, window: Window) -> NDArray[Any]:
        return self.pixels[self.window.locate(window)]

    def restrict_usable(self, usable: NDArray[np.uint8] | None, window: Window) -> NDArray[np.uint8] | None:
        return None if usable is None else usable[self.window.locate(window)].copy()

    def read(self, window: Window, buffer: Array) -> Array:
        # Memory that is asked for anew for every band costs more than its filtering.
        pixels = self.restrict(window)
        block = buffer[:pixels.size].reshape(pixels.shape)
        block[:] = pixels
        return block

    def buffer(self, rows: int) -> Array:
        return np.empty(min(rows, self.window.height) * self.window.width)


def _hold(source: ImageSource, window: Window, halo: int, find_usable: FindUsable | None) -> _Held:
    wide = window.grow(halo).intersection(source.extent)
    usable = None if find_usable is None else find_usable(wide)
    pixels = fill_excluded(source.read(wide), usable)
    return _Held(wide, pixels, usable)


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
