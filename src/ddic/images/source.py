"""What the rest of the program needs to know of an image, wherever its pixels come from.

What stands in for pixels that are left out, so that what lies under a mask reaches no pixel beside it.
"""

from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from ddic.arrays import BoolArray
from ddic.images.window import Window


class SizedImage(Protocol):
    """Width and height of a plane image, which follow from the box of its pixels."""

    @property
    def extent(self) -> Window:
        """The box of all its pixels."""

    @property
    def width(self) -> int:
        """Number of columns."""
        return self.extent.width

    @property
    def height(self) -> int:
        """Number of rows."""
        return self.extent.height


class ImageSource(SizedImage, Protocol):
    """A grey-level image that is read box by box.

    Its path is its name in messages and checksums.
    """

    @property
    def path(self) -> Path:
        """Where the image comes from."""

    @property
    def saturation(self) -> float | None:
        """Largest grey level of an integer image, None for a float image."""

    def read(self, window: Window) -> NDArray[Any]:
        """Read a window.

        Parameters
        ----------
        window : Window
            Inside the image.

        Returns
        -------
        array of the window's shape
            Grey levels in their own type.
        """


def fill_excluded(pixels: NDArray[Any], usable: NDArray[np.uint8] | None) -> NDArray[Any]:
    """Give pixels that do not count the value of the nearest one that does.

    A prefilter passes every pixel on to its neighbours, and a jump rings further than a plateau. The fill depends on
    the pixels that count alone: neither garbage nor black under a mask changes anything.

    Parameters
    ----------
    pixels : (height, width) or (depth, height, width) array
        Grey levels. In a volume those farther off than FILLED are zeros.
    usable : array of the same shape, or None
        0 where a pixel is left out. Pixels that are not finite are left out too.

    Returns
    -------
    array of the same shape
        Of the same type; the same array where nothing is left out. Zeros where no pixel counts.
    """
    absent = _find_absent(pixels, usable)
    if absent is None or not absent.any():
        return pixels
    if absent.all():
        return np.zeros_like(pixels)
    if pixels.ndim == 2:
        return _fill_plane(pixels, absent)[0]
    filled, is_known = np.where(absent, pixels.dtype.type(0), pixels), ~absent
    for k in np.flatnonzero(absent.any(axis=(1, 2)) & is_known.any(axis=(1, 2))):
        in_plane, distance = _fill_plane(pixels[k], absent[k])
        is_known[k] = distance <= FILLED
        filled[k][is_known[k]] = in_plane[is_known[k]]
    for k in np.flatnonzero(~is_known.all(axis=(1, 2))):
        is_left = ~is_known[k]
        for other in (k + sign * step for step in range(1, FILLED + 1) for sign in (-1, 1)):
            if 0 <= other < len(pixels):
                found = is_left & is_known[other]
                filled[k][found] = filled[other][found]
                is_left &= ~found
    return filled


FILLED = 10
"""Voxels up to which an excluded one is filled in its plane, then from planes before and after it: as far as a spline's
coefficient is taken from. What lies farther off has no say, so that a larger window gives the same."""


def _fill_plane(pixels: NDArray[Any], absent: BoolArray) -> tuple[NDArray[Any], NDArray[np.float32]]:
    """The same of a plane image of which some pixels count, and how far off the nearest of these is from each."""
    # Each pixel that counts has a label, and the others have that of their nearest.
    distance, labels = cv2.distanceTransformWithLabels(absent.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5,
                                                       labelType=cv2.DIST_LABEL_PIXEL)
    values = np.empty(int(labels.max()) + 1, dtype=pixels.dtype)
    values[labels[~absent]] = pixels[~absent]
    filled = pixels.copy()
    filled[absent] = values[labels[absent]]
    return filled, distance


def _find_absent(pixels: NDArray[Any], usable: NDArray[np.uint8] | None) -> BoolArray | None:
    absent = None if usable is None else usable == 0
    if pixels.dtype.kind == "f":
        not_finite = ~np.isfinite(pixels)
        absent = not_finite if absent is None else absent | not_finite
    return absent


def without_neighbours(usable: NDArray[np.uint8], before: int, after: int) -> NDArray[np.uint8]:
    """Leave out the pixels that are interpolated from one that is left out.

    Parameters
    ----------
    usable : (height, width) or (depth, height, width) array
        0 where a pixel is left out.
    before, after : int
        Pixels on either side, along all axes, that a value is interpolated from.

    Returns
    -------
    array of the same shape
        0 where one of them is left out; beyond the edge none is.
    """
    size = before + 1 + after
    square = np.ones((size, size), np.uint8)
    if usable.ndim == 2:
        return np.asarray(cv2.erode(usable, square, anchor=(before, before)), dtype=np.uint8)
    in_planes = np.stack([cv2.erode(plane, square, anchor=(before, before)) for plane in usable])
    return _without_planes(in_planes, in_planes, before, after)


def _without_planes(usable: NDArray[np.uint8], others: NDArray[np.uint8], before: int, after: int) -> NDArray[np.uint8]:
    """Leave out the voxels at whose place one is left out in a plane before or after."""
    found = usable.copy()
    for step in range(1, before + 1):
        np.minimum(found[step:], others[:-step], out=found[step:])
    for step in range(1, after + 1):
        np.minimum(found[:-step], others[step:], out=found[:-step])
    return found


def without_cross(usable: NDArray[np.uint8], reach: int) -> NDArray[np.uint8]:
    """Leave out the pixels whose slope along an axis is taken from one that is left out.

    Parameters
    ----------
    usable : (height, width) or (depth, height, width) array
        0 where a pixel is left out.
    reach : int
        Pixels on either side, along one axis at a time.

    Returns
    -------
    array of the same shape
        0 where one of them is left out; beyond the edge none is.
    """
    cross = np.zeros((2 * reach + 1, 2 * reach + 1), np.uint8)
    cross[reach, :] = cross[:, reach] = 1
    if usable.ndim == 2:
        return np.asarray(cv2.erode(usable, cross), dtype=np.uint8)
    in_planes = np.stack([cv2.erode(plane, cross) for plane in usable])
    return _without_planes(in_planes, usable, reach, reach)
