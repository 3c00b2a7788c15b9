"""Images averaged over square blocks of pixels, and images blurred as by motion or a camera out of focus."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import prod
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array
from ddic.images.source import SizedImage, fill_excluded
from ddic.images.sub_image import MaskedSource
from ddic.images.window import Window

_BAND_PIXELS = 1 << 24

_CACHED_PIXELS = 1 << 18
"""Pixels that are averaged at a time, as floating-point numbers a megabyte. More are written to memory and read again;
fewer cost calls."""


@dataclass(frozen=True)
class ArraySource(SizedImage):
    """An image held in memory; its windows look into it and cannot be written to.

    Attributes
    ----------
    path : Path
        Where it comes from.
    values : (height, width) array
        Grey levels in their own type.
    saturation : float or None
        Largest grey level that the integer type holds, None for float images.
    """

    path: Path
    values: NDArray[Any]
    saturation: float | None = None

    @cached_property
    def extent(self) -> Window:
        """The box of all its pixels."""
        return Window.of_size(*self.values.shape[::-1])

    def read(self, window: Window) -> NDArray[Any]:
        """Look into a window, which cannot be written to; raises ValueError where it leaves the image or is empty."""
        part = self.values[self.extent.locate_inside(window)]
        part.flags.writeable = False
        return part


@dataclass(frozen=True)
class Blocks:
    """Rows of blocks of an image, planes of a volume.

    Attributes
    ----------
    values : (rows, columns) or (planes, rows, columns) array
        Mean grey levels.
    usable : array of the same shape, or None
        1 where all pixels of a block count, else 0; None where nothing can be left out.
    """

    values: NDArray[np.float32]
    usable: NDArray[np.float32] | None


def bin_image(source: MaskedSource, factor: int) -> MaskedSource:
    """Average an image over square or cubic blocks, ``factor`` pixels a side; one counts where all its pixels do.

    Block (X, Y) is centred on x = factor X + (factor - 1) / 2, likewise y. The image is read in bands; pixels that fill
    no block are left out. The result is in memory, a pixel a block.
    """
    return join_blocks(source, [bin_rows(source, factor, range(source.extent.sizes[-1] // factor))])


def bin_rows(source: MaskedSource, factor: int, rows: range) -> Blocks:
    """Average some rows, or planes, of the blocks of ``bin_image``."""
    blocks = Window.of_size(*(size // factor for size in source.extent.sizes)).take_rows(rows.start, rows.stop)
    return bin_window(source, factor, blocks.refine(factor))


def bin_window(source: MaskedSource, factor: int, window: Window) -> Blocks:
    """Average a part of an image, of whole blocks, over these; the first of them begins where the part does."""
    n_rows, *others = (size // factor for size in window.shape)
    values = np.zeros((n_rows, *others), dtype=np.float32)
    usable = np.ones((n_rows, *others), dtype=np.float32)
    anything_excluded, n_across, begin = False, prod(others), window.lower[-1]
    at_once = max(_BAND_PIXELS // (factor**len(window.sizes) * max(n_across, 1)), 1)
    for first in range(0, n_rows if n_across else 0, at_once):
        band = slice(first, min(first + at_once, n_rows))
        part = window.take_rows(begin + band.start * factor, begin + band.stop * factor)
        values[band] = _means(source.image.read(part), factor)
        mask = source.find_usable(part)
        if mask is not None:
            anything_excluded = True
            # A mean of ones and zeros: 1 only where all are.
            usable[band] = _means(mask, factor) == 1.0
    return Blocks(values, usable if anything_excluded else None)


def join_blocks(source: MaskedSource, bands: Sequence[Blocks]) -> MaskedSource:
    """Join all rows of blocks, in order, to the binned image, which is in memory, a pixel a block."""
    path = source.image.path
    mask = None
    if any(band.usable is not None for band in bands):
        mask = ArraySource(path, np.concatenate([np.ones_like(b.values) if b.usable is None else b.usable
                                                 for b in bands]))
    return MaskedSource(ArraySource(path, np.concatenate([b.values for b in bands])), mask, excludes_taps=False)


@dataclass(frozen=True, eq=False)
class BinnedSource(SizedImage):
    """Blocks of an image, averaged where they are read, from smaller ones where these are held.

    Attributes
    ----------
    pixels : MaskedSource
        The image.
    held : Blocks
        Rows of the smaller blocks, in memory.
    first_row : int
        The first of these rows.
    factor, ratio : int
        Side of a smaller block, pixels, and of a block, smaller blocks.
    shows_mask : bool
        Whether its values are 1 where a block counts, else 0, in place of grey levels.
    """

    pixels: MaskedSource
    held: Blocks
    first_row: int
    factor: int
    ratio: int = 1
    shows_mask: bool = False

    @property
    def path(self) -> Path:
        """Where the image comes from."""
        return self.pixels.image.path

    @property
    def saturation(self) -> float | None:
        """None: means are no integers."""
        return None

    @cached_property
    def extent(self) -> Window:
        """The box of all blocks."""
        side = self.factor * self.ratio
        return Window.of_size(*(size // side for size in self.pixels.extent.sizes))

    def read(self, window: Window) -> NDArray[np.float32]:
        """Average the blocks of a window, inside the image."""
        wide = window.refine(self.ratio)
        first, last = wide.lower[-1], wide.upper[-1]
        begin, end = np.clip((self.first_row, self.first_row + len(self.held.values)), first, last).tolist()
        averaged = [self._average(wide.take_rows(first, begin)), self._look_up(wide.take_rows(begin, end)),
                    self._average(wide.take_rows(end, last))]
        values = np.concatenate([rows for rows in averaged if len(rows)])
        if self.ratio == 1:
            return values
        means = _means(values, self.ratio)
        return np.asarray(means == 1.0, dtype=np.float32) if self.shows_mask else means

    def _average(self, window: Window) -> NDArray[np.float32]:
        return self._choose(bin_window(self.pixels, self.factor, window.refine(self.factor)))

    def _look_up(self, window: Window) -> NDArray[np.float32]:
        held = self._choose(self.held)
        all_held = self.extent.refine(self.ratio).take_rows(self.first_row, self.first_row + len(held))
        return held[all_held.locate(window)]

    def _choose(self, blocks: Blocks) -> NDArray[np.float32]:
        if not self.shows_mask:
            return blocks.values
        return np.ones_like(blocks.values) if blocks.usable is None else blocks.usable


def _finite(pixels: NDArray[Any]) -> NDArray[np.float32]:
    grey = pixels.astype(np.float32)
    if not np.issubdtype(pixels.dtype, np.integer):
        grey[~np.isfinite(grey)] = 0.0
    return grey


def _means(pixels: NDArray[Any], factor: int) -> NDArray[np.float32]:
    """Means over blocks; what is not finite counts as 0."""
    if pixels.ndim == 3:
        n_z, n_y, n_x = (size // factor for size in pixels.shape)
        # The slowest axis first: fewer numbers are left for the others.
        summed = _finite(pixels).reshape(n_z, factor, n_y * factor, n_x * factor).sum(axis=1)
        summed = summed.reshape(n_z, n_y, factor, n_x * factor).sum(axis=2)
        return np.asarray(summed.reshape(n_z, n_y, n_x, factor).sum(axis=3) / np.float32(factor**3))
    height, width = pixels.shape
    at_once = max(_CACHED_PIXELS // (factor * width), 1) * factor
    means = np.empty((height // factor, width // factor), dtype=np.float32)
    for first in range(0, height, at_once):
        of_some = means[first // factor:(first + at_once) // factor]
        of_some[:] = cv2.resize(_finite(pixels[first:first + at_once]), of_some.shape[::-1],
                                interpolation=cv2.INTER_AREA)
    return means


BLUR_NOTE = "the frame is less sharp than the reference image"
"""How a note begins that tells of a reference image blurred like its frame."""

REACH = 3.0
"""Standard deviations beyond which a blur is nothing."""


@dataclass(frozen=True)
class Blur:
    """A Gaussian blur, which any other is like where it is symmetric.

    Attributes
    ----------
    along, across : float
        Standard deviations in and across its direction, pixels.
    direction : float
        From x towards y, radians.
    """

    along: float
    across: float
    direction: float

    @property
    def reach(self) -> int:
        """Pixels on either side that a value is made of."""
        return int(np.ceil(REACH * max(self.along, self.across)))

    @cached_property
    def kernel(self) -> Array:
        """Weights of the pixels about one, (2 reach + 1, 2 reach + 1), summing to 1."""
        offsets = np.arange(-self.reach, self.reach + 1)
        x, y = np.meshgrid(offsets, offsets)
        c, s = np.cos(self.direction), np.sin(self.direction)
        # A blur of less than a pixel is one of the pixel grid.
        along, across = (np.hypot(deviation, SMALLEST) for deviation in (self.along, self.across))
        weights = np.exp(-0.5 * (((c * x + s * y) / along)**2 + ((c * y - s * x) / across)**2))
        return np.asarray(weights / weights.sum())

    def apply(self, pixels: NDArray[np.float32]) -> NDArray[np.float32]:
        """Blur pixels, (height, width), grey levels, reflected at the edge."""
        return np.asarray(cv2.filter2D(pixels, -1, self.kernel, borderType=cv2.BORDER_REFLECT_101))


SMALLEST = 0.25
"""Standard deviation, pixels, below which the sampled kernel is that of a single pixel anyway."""


@dataclass(frozen=True)
class BlurredSource(SizedImage):
    """An image, blurred window by window.

    Attributes
    ----------
    source : MaskedSource
        The sharp image. What is left out of it is filled by its neighbours before.
    blur : Blur
        What is done to it.
    """

    source: MaskedSource
    blur: Blur

    @property
    def path(self) -> Path:
        """Where the sharp image comes from."""
        return self.source.image.path

    @property
    def extent(self) -> Window:
        """The box of all its pixels."""
        return self.source.extent

    @property
    def saturation(self) -> float | None:
        """None: blurred grey levels are no integers."""
        return None

    def read(self, window: Window) -> NDArray[np.float32]:
        """Read the blurred grey levels of a window, inside the image."""
        wide = window.grow(self.blur.reach).intersection(self.extent)
        sharp = fill_excluded(self.source.image.read(wide), self.source.find_usable(wide))
        return self.blur.apply(np.asarray(sharp, dtype=np.float32))[wide.locate(window)]
