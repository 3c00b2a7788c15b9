"""What the grey levels of a whole image are like, read a band of rows at a time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.images.source import ImageSource
from ddic.images.window import Window

BAND_PIXELS = 1 << 20
"""Pixels of a band: more make fewer reads, and take more memory."""


@dataclass(frozen=True)
class GreyLevels:
    """Grey levels of an image; pixels that are not finite are counted and left out of the rest.

    Attributes
    ----------
    lowest, highest, mean : float
        Grey levels; infinite and nan where no pixel is finite.
    n_saturated : int
        Pixels at the largest value of the integer type.
    n_not_finite : int
        Pixels that are nan or infinite.
    gradient_energy : float
        Mean of |grad f|^2 over the inner pixels, (grey level / px)^2.
    """

    lowest: float
    highest: float
    mean: float
    n_saturated: int
    n_not_finite: int
    gradient_energy: float


def measure_grey_levels(source: ImageSource) -> GreyLevels:
    """Measure the grey levels of an image; gradients are central differences.

    Parameters
    ----------
    source : ImageSource
        The image.

    Returns
    -------
    GreyLevels
        Of all its pixels.
    """
    lowest, highest, total = np.inf, -np.inf, 0.0
    n_finite, n_saturated = 0, 0
    energy, n_energy = 0.0, 0
    for rows in _bands(source):
        # A row more on either side, for the differences.
        top = max(rows.y0 - 1, 0)
        bottom = min(rows.y1 + 1, source.height)
        band = source.read(Window(0, top, source.width, bottom))
        own = band[rows.y0 - top:rows.y1 - top]
        finite = own[np.isfinite(own)]
        if finite.size:
            lowest = min(lowest, float(finite.min()))
            highest = max(highest, float(finite.max()))
            total += float(finite.sum(dtype=np.float64))
        n_finite += finite.size
        if source.saturation is not None:
            n_saturated += int(np.count_nonzero(own >= source.saturation))
        squares = _squared_gradient(band.astype(np.float64))
        energy += float(squares.sum())
        n_energy += squares.size
    return GreyLevels(
        lowest=lowest,
        highest=highest,
        mean=total / n_finite if n_finite else np.nan,
        n_saturated=n_saturated,
        n_not_finite=source.width * source.height - n_finite,
        gradient_energy=energy / n_energy if n_energy else 0.0,
    )


def check_finite(source: ImageSource, mask: NDArray[np.bool_] | None = None) -> None:
    """Check that a float image holds no nan or infinity but where its mask leaves it out.

    Parameters
    ----------
    source : ImageSource
        The image.
    mask : (height, width) array, optional
        True where pixels are used; all are where it is left out.

    Raises
    ------
    InputError
        Where there are such pixels; it tells their number and the first one.
    """
    if source.saturation is not None:
        return
    count = 0
    first: tuple[int, int] | None = None
    for rows in _bands(source):
        bad = ~np.isfinite(source.read(rows))
        if mask is not None:
            bad &= mask[rows.y0:rows.y1]
        if first is None and bad.any():
            row, column = np.unravel_index(int(bad.argmax()), bad.shape)
            first = (int(column), rows.y0 + int(row))
        count += int(np.count_nonzero(bad))
    if count:
        raise InputError(f"{source.path}: {count} pixel(s) are NaN or infinite, the first at "
                         f"(x, y) = {first}; leave them out with a mask image (0 there)")


def _bands(source: ImageSource) -> Iterator[Window]:
    """Windows of whole rows from top to bottom, of about BAND_PIXELS each."""
    n_rows = max(1, BAND_PIXELS // source.width)
    for y in range(0, source.height, n_rows):
        yield Window(0, y, source.width, min(y + n_rows, source.height))


def _squared_gradient(band: NDArray[np.float64]) -> NDArray[np.float64]:
    """|grad f|^2 of a band's inner pixels, of those where it is finite."""
    by_x = 0.5 * (band[1:-1, 2:] - band[1:-1, :-2])
    by_y = 0.5 * (band[2:, 1:-1] - band[:-2, 1:-1])
    squares = by_x**2 + by_y**2
    return np.asarray(squares[np.isfinite(squares)])
