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

OVER_ALL = 2.5
"""Above matplotlib's patches and lines, below its texts."""


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

    def draw(self, axes: Axes, size: float = 1.0, opacity: float = 1.0) -> None:
        """Draw in grey, pixel centres at integers.

        Parameters
        ----------
        axes : Axes
            In image coordinates.
        size : float, optional
            Of a pixel, in the axes' unit.
        opacity : float, optional
            Below 1, it is drawn over everything that is there.
        """
        left, right, bottom, top = find_thinned_extent(self.pixels.shape, self.step)
        axes.imshow(self.pixels, cmap="gray", interpolation="nearest", rasterized=True,
                    zorder=0 if opacity == 1.0 else OVER_ALL, alpha=opacity,
                    extent=(size * left, size * right, size * bottom, size * top))

    def clip(self, bounds: tuple[float, float, float, float], size: float = 1.0) -> tuple[float, float, float, float]:
        """Find the part of a box that lies in the image, whose pixels reach half a pixel beyond their centres.

        Parameters
        ----------
        bounds : (float, float, float, float)
            x0, y0, x1, y1, in the axes' unit.
        size : float, optional
            Of a pixel, in that unit.

        Returns
        -------
        (float, float, float, float)
            The same of the part.
        """
        x0, y0, x1, y1 = bounds
        return (max(x0, -0.5 * size), max(y0, -0.5 * size), min(x1, (self.width - 0.5) * size),
                min(y1, (self.height - 0.5) * size))


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
