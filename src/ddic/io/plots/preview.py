"""An image thinned out to what a figure can show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from ddic.images.source import ImageSource
from ddic.images.window import Window

LARGEST_SIDE = 2000


@dataclass(frozen=True)
class Preview:
    """An image with every ``step``-th pixel.

    Attributes
    ----------
    pixels : (rows, columns) array
        Grey levels.
    step : int
        Pixels from one to the next.
    width, height : int
        Of the whole image, pixels.
    """

    pixels: NDArray[Any]
    step: int
    width: int
    height: int

    def draw(self, axes: Axes) -> None:
        """Draw in grey, pixel centres at integers.

        Parameters
        ----------
        axes : Axes
            In image coordinates.
        """
        axes.imshow(self.pixels, cmap="gray", interpolation="nearest", zorder=0,
                    extent=find_thinned_extent(self.pixels.shape, self.step))


def read_preview(source: ImageSource) -> Preview:
    """Read an image row by row and keep at most 2000 pixels a side.

    Parameters
    ----------
    source : ImageSource
        The image.

    Returns
    -------
    Preview
        Thinned out evenly.
    """
    step = -(-max(source.width, source.height) // LARGEST_SIDE)
    if step == 1:
        pixels = source.read(Window(0, 0, source.width, source.height))
    else:
        bands = range(0, source.height, 64 * step)
        pixels = np.concatenate([
            source.read(Window(0, y, source.width, min(y + 64 * step, source.height)))[::step, ::step]
            for y in bands])
    return Preview(pixels, step, source.width, source.height)


def find_thinned_extent(shape: tuple[int, ...], step: int) -> tuple[float, float, float, float]:
    """Find the extent of a thinned image, y down.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns that are left.
    step : int
        Pixels from one to the next.

    Returns
    -------
    (float, float, float, float)
        Left, right, bottom, top, pixels.
    """
    return (-0.5 * step, (shape[1] - 0.5) * step, (shape[0] - 0.5) * step, -0.5 * step)
