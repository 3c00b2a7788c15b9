"""An image as sharp, or as little sharp, as another: what a camera sees that moves, or is out of focus."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ddic.images.fill import fill_excluded
from ddic.images.sub_image import MaskedSource
from ddic.images.window import Window

Array = NDArray[np.float64]

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
        """Blur pixels, reflected at the edge.

        Parameters
        ----------
        pixels : (height, width) array
            Grey levels.

        Returns
        -------
        (height, width) array
            Grey levels.
        """
        return np.asarray(cv2.filter2D(pixels, -1, self.kernel, borderType=cv2.BORDER_REFLECT_101))


SMALLEST = 0.25
"""Standard deviation, pixels, below which the sampled kernel is that of a single pixel anyway."""


@dataclass(frozen=True)
class BlurredSource:
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
    def width(self) -> int:
        """Number of columns."""
        return self.source.image.width

    @property
    def height(self) -> int:
        """Number of rows."""
        return self.source.image.height

    @property
    def saturation(self) -> float | None:
        """None: blurred grey levels are no integers."""
        return None

    def read(self, window: Window) -> NDArray[np.float32]:
        """Read a window.

        Parameters
        ----------
        window : Window
            Inside the image.

        Returns
        -------
        (window.height, window.width) array
            Grey levels.
        """
        wide = window.grow(self.blur.reach).clip(self.width, self.height)
        sharp = fill_excluded(self.source.image.read(wide), self.source.find_usable(wide))
        return self.blur.apply(np.asarray(sharp, dtype=np.float32))[wide.locate(window)]
