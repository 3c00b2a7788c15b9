"""The window of a deformed image that one subdomain needs, read again when displacements outgrow it."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array
from ddic.images.source import ImageSource
from ddic.images.spline import GradientImage, SplineImage, read_gradient, read_spline
from ddic.images.threads import ONE_THREAD, Threads
from ddic.images.volume import read_coefficients, read_values
from ddic.images.window import Window

GROWTH = 8
"""Pixels read beyond what is asked for, so that the next iterations need no new read."""

SPARE = 2.0
"""Pixels held over those wanted from which on a window is read again, smaller. A larger value keeps more memory where
displacements shrank, a smaller one reads more often."""

SMALLEST = 16
"""Least width and height of a window: reflection at the image's edge needs a few pixels."""


@dataclass(frozen=True)
class MaskedSource:
    """An image with what is excluded from it.

    Attributes
    ----------
    image : ImageSource
        The image.
    mask : ImageSource, optional
        An image of the same size, zero where pixels are left out.
    saturated_from : float, optional
        Grey level from which on pixels are left out.
    excludes_taps : bool
        Whether to leave out also what is interpolated from such pixels. Coarse images would lose too much, and only
        start a measurement.
    """

    image: ImageSource
    mask: ImageSource | None = None
    saturated_from: float | None = None
    excludes_taps: bool = True

    @property
    def extent(self) -> Window:
        """The whole image."""
        return self.image.extent

    @property
    def may_exclude(self) -> bool:
        """Whether pixels can be left out at all."""
        return self.mask is not None or self.saturated_from is not None

    def read_whole(self) -> Array:
        """Read all grey levels, left out or not: of coarse images, which are small."""
        return self.image.read(self.extent).astype(np.float64)

    def find_usable(self, window: Window) -> NDArray[np.uint8] | None:
        """Find the pixels of a window that count, 1, and those left out, 0; None where nothing can be left out."""
        if not self.may_exclude:
            return None
        usable = np.ones(window.shape, dtype=np.uint8)
        if self.mask is not None:
            usable &= np.asarray(self.mask.read(window) != 0, dtype=np.uint8)
        if self.saturated_from is not None:
            usable &= np.asarray(self.image.read(window) < self.saturated_from, dtype=np.uint8)
        return usable


def read_reference(source: MaskedSource, window: Window, degree: int, threads: Threads = ONE_THREAD) -> GradientImage:
    """Read grey levels and gradient of a window, clipped to the reference image, larger if too small for a spline."""
    window = _sizeable(window, source.extent)
    if len(window.sizes) == 3:
        return read_values(source.image, window, source.find_usable, excludes_taps=source.excludes_taps)
    return read_gradient(source.image, window, degree, source.find_usable, threads, excludes_taps=source.excludes_taps)


@dataclass
class DeformedSubImage:
    """The deformed image as one subdomain sees it; the only mutable part is the window held.

    Attributes
    ----------
    source : MaskedSource
        The deformed image.
    degree : int
        Of the spline, 3 or 5.
    threads : Threads
        Do the filtering.
    """

    source: MaskedSource
    degree: int
    threads: Threads = ONE_THREAD
    _spline: SplineImage | None = field(default=None, repr=False)

    def hold(self, window: Window) -> None:
        """Hold the window that all who share it want, clipped: read where it outgrows what is held, or far less is."""
        needed = window.intersection(self.source.extent)
        wanted = _sizeable(window.grow(GROWTH), self.source.extent)
        held = None if self._spline is None else self._spline.window
        if held is None or not held.contains(needed) or held.n_pixels > SPARE * wanted.n_pixels:
            self._spline = self._read(wanted)

    def get_spline(self, window: Window) -> SplineImage:
        """Give the spline of a window that holds another, clipped to the image; it is read again only if outgrown."""
        needed = window.intersection(self.source.extent)
        if self._spline is None or not self._spline.window.contains(needed):
            grown = window if self._spline is None else window.union(self._spline.window)
            self._spline = self._read(_sizeable(grown.grow(GROWTH), self.source.extent))
        return self._spline

    def read_aside(self, window: Window) -> SplineImage:
        """Give the spline of a small window, from the one held if that is there: it becomes no larger."""
        needed = window.intersection(self.source.extent)
        if self._spline is not None and self._spline.window.contains(needed):
            return self._spline
        return self._read(_sizeable(window, self.source.extent))

    def _read(self, window: Window) -> SplineImage:
        if len(window.sizes) == 3:
            return read_coefficients(self.source.image, window, self.source.find_usable, self.threads,
                                     excludes_taps=self.source.excludes_taps)
        return read_spline(self.source.image, window, self.degree, self.source.find_usable, self.threads,
                           excludes_taps=self.source.excludes_taps)


def _sizeable(window: Window, extent: Window) -> Window:
    """A box in an image, as large as a spline needs where the image is."""
    clipped = window.intersection(extent)
    lower = [max(min(first, end - SMALLEST), 0) for first, end in zip(clipped.lower, extent.upper, strict=True)]
    upper = [min(max(last, first + SMALLEST), end)
             for last, first, end in zip(clipped.upper, lower, extent.upper, strict=True)]
    return Window.between(lower, upper)
