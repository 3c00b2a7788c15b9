"""Images as the pixel kernels take them: flat arrays, the same types whether or not anything is excluded."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from ddic.functionals.pixel_kernels import DeformedPixels, ReferencePixels
from ddic.images.spline import GradientImage, SplineImage
from ddic.images.window import Window

_NOTHING_EXCLUDED = np.zeros((0, 0), dtype=np.uint8)


def convert_reference(f: GradientImage) -> ReferencePixels:
    """Convert a window of the reference image; its arrays are not copied.

    Parameters
    ----------
    f : GradientImage
        f and grad f.

    Returns
    -------
    ReferencePixels
        The same.
    """
    return ReferencePixels(_flatten(f.values), _flatten(f.by_x), _flatten(f.by_y), _count_row_length(f.values),
                           f.window.x0, f.window.y0, _or_nothing(f.usable))


def convert_deformed(g: SplineImage, extent: Window) -> DeformedPixels:
    """Convert a window of the deformed image; its arrays are not copied.

    Parameters
    ----------
    g : SplineImage
        Coefficients of g.
    extent : Window
        The whole image.

    Returns
    -------
    DeformedPixels
        The same.
    """
    return DeformedPixels(_flatten(g.coefficients), _count_row_length(g.coefficients), g.degree,
                          g.window.x0, g.window.y0, _or_nothing(g.usable), extent.width, extent.height)


def _flatten(image: NDArray[Any]) -> NDArray[Any]:
    """An image (height, width), or a part of one, as one sequence of rows of ``_count_row_length``."""
    if image.flags.c_contiguous:
        return image.reshape(-1)
    height, width = image.shape
    n = (height - 1) * _count_row_length(image) + width
    return as_strided(image, (n,), (image.itemsize,))


def _count_row_length(image: NDArray[Any]) -> int:
    """Numbers from one row of an image, or of a part of one, to the next."""
    return int(image.strides[0] // image.itemsize)


def _or_nothing(usable: NDArray[np.uint8] | None) -> NDArray[np.uint8]:
    """An array whether or not anything is excluded, so that kernels are compiled once."""
    return _NOTHING_EXCLUDED if usable is None else usable
