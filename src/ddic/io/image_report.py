"""What an image offers to correlation, measured by bands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.images.source import ImageSource
from ddic.images.window import Window

BAND_PIXELS = 1 << 20


@dataclass(frozen=True)
class ImageReport:
    """Grey levels of an image; pixels that are not finite are counted and left out of the rest.

    lowest, highest, mean: grey levels. n_saturated: at the largest value of the integer type.
    gradient_energy: mean of |grad f|^2 over the inner pixels, (grey level / px)^2.
    """

    lowest: float
    highest: float
    mean: float
    n_saturated: int
    n_not_finite: int
    gradient_energy: float


def image_report(source: ImageSource) -> ImageReport:
    """Measure an image; gradients are central differences. Only a band of rows is held at a time."""
    lowest, highest, total, saturated, finite = np.inf, -np.inf, 0.0, 0, 0
    energy, n_energy = 0.0, 0
    rows = max(1, BAND_PIXELS // source.width)
    for y in range(0, source.height, rows):
        top, bottom = max(y - 1, 0), min(y + rows + 1, source.height)
        band = source.read(Window(0, top, source.width, bottom))
        own = band[y - top:y - top + rows]
        good = own[np.isfinite(own)]
        if good.size:
            lowest, highest = min(lowest, float(good.min())), max(highest, float(good.max()))
            total += float(good.sum(dtype=np.float64))
        finite += good.size
        if source.saturation is not None:
            saturated += int(np.count_nonzero(own >= source.saturation))
        squares = _squared_gradient(band.astype(np.float64))
        energy += float(squares.sum())
        n_energy += squares.size
    n_pixels = source.width * source.height
    return ImageReport(lowest, highest, total / finite if finite else np.nan, saturated, n_pixels - finite,
                       energy / n_energy if n_energy else 0.0)


def _squared_gradient(band: NDArray[np.float64]) -> NDArray[np.float64]:
    across = 0.5 * (band[1:-1, 2:] - band[1:-1, :-2])
    down = 0.5 * (band[2:, 1:-1] - band[:-2, 1:-1])
    squares = across**2 + down**2
    return np.asarray(squares[np.isfinite(squares)])
