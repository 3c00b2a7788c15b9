"""Coarse-grained images: means over square blocks of pixels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ddic.images.sub_image import MaskedSource
from ddic.images.window import Window

_BAND_PIXELS = 1 << 24


@dataclass(frozen=True)
class ArraySource:
    """An image held in memory; values (height, width) float32."""

    path: Path
    values: NDArray[np.float32]
    saturation: float | None = None

    @property
    def width(self) -> int:
        """Number of columns."""
        return int(self.values.shape[1])

    @property
    def height(self) -> int:
        """Number of rows."""
        return int(self.values.shape[0])

    def read(self, window: Window) -> NDArray[np.float32]:
        """Grey levels of a window inside the image."""
        return self.values[window.y0: window.y1, window.x0: window.x1]


def bin_image(source: MaskedSource, factor: int) -> MaskedSource:
    """Mean over blocks of factor x factor pixels; a block counts where all its pixels do.

    Block (X, Y) is centred on x = factor X + (factor - 1) / 2, likewise y. The image is read in bands.
    """
    width, height = source.image.width // factor, source.image.height // factor
    values = np.empty((height, width), dtype=np.float32)
    usable = np.ones((height, width), dtype=np.float32)
    anything_excluded = False
    rows = max(_BAND_PIXELS // (factor**2 * max(width, 1)), 1)
    for y0 in range(0, height, rows):
        y1 = min(y0 + rows, height)
        window = Window(0, y0 * factor, width * factor, y1 * factor)
        blocks = (y1 - y0, factor, width, factor)
        grey = np.nan_to_num(source.image.read(window).astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
        values[y0:y1] = grey.reshape(blocks).mean(axis=(1, 3))
        mask = source.usable(window)
        if mask is not None:
            anything_excluded = True
            usable[y0:y1] = mask.reshape(blocks).min(axis=(1, 3))
    mask_source = ArraySource(source.image.path, usable) if anything_excluded else None
    return MaskedSource(ArraySource(source.image.path, values), mask_source)
