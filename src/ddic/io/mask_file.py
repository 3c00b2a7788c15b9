"""Mask images: not zero = use the pixel."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.images.window import Window
from ddic.io.image_file import hold_image


def read_mask(path: Path, width: int, height: int) -> NDArray[np.bool_]:
    """Read a mask.

    Parameters
    ----------
    path : Path
        An image that is not 0 where pixels are used.
    width, height : int
        Of the image that it belongs to, pixels.

    Returns
    -------
    (height, width) array of bool
        True where the pixel is used.

    Raises
    ------
    InputError
        Where it cannot be read or has another size.
    """
    source = hold_image(path)
    if (source.width, source.height) != (width, height):
        raise InputError(f"{path}: the mask is {source.width}x{source.height} px, but its image is "
                         f"{width}x{height} px; give a mask of the image's size")
    return np.asarray(source.read(Window(0, 0, width, height)) != 0)
