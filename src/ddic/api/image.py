"""Images given as files or as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.images.binned import ArraySource
from ddic.images.grey_levels import check_finite
from ddic.images.source import ImageSource
from ddic.images.sub_image import MaskedSource
from ddic.parallel.team import Team
from ddic.problem.cameras import open_on_all_ranks


@dataclass(frozen=True, eq=False)
class Image:
    """A grey-level image with what is left out of it.

    Attributes
    ----------
    pixels : (height, width) array, str or Path
        Grey levels of any integer or float type, or the file that holds them.
    mask : (height, width) array, optional
        Zero, or False, where pixels are left out; none is by default.
    exclude_saturated : bool
        Leave out pixels at the largest value of the image's integer type.
    """

    pixels: NDArray[Any] | str | Path
    mask: NDArray[Any] | None = None
    exclude_saturated: bool = False


ImageLike = Image | NDArray[Any] | str | Path
"""An image, its grey levels (height, width), or its file."""


def open_given_image(team: Team, given: ImageLike, name: str) -> MaskedSource:
    """Open an image that the user gave; collective.

    Parameters
    ----------
    team : Team
        All ranks, which give the same image.
    given : ImageLike
        What the user gave.
    name : str
        What messages call it.

    Returns
    -------
    MaskedSource
        Read window by window.

    Raises
    ------
    InputError
        On all ranks, where it is no image, or its mask is not as large.
    """
    image = given if isinstance(given, Image) else Image(given)
    source = _open_pixels(team, image.pixels, name)
    mask = None
    if image.mask is not None:
        mask = ArraySource(Path(f"{name}'s mask"), _check_mask(np.asarray(image.mask), source, name))
    check_finite(source, None if mask is None else mask.values != 0)
    return MaskedSource(source, mask, image.exclude_saturated)


def _open_pixels(team: Team, pixels: NDArray[Any] | str | Path, name: str) -> ImageSource:
    if isinstance(pixels, str | Path):
        return open_on_all_ranks(team)(Path(pixels))
    values = np.ascontiguousarray(pixels)
    if values.ndim != 2:
        raise InputError(f"{name}: an array of shape {values.shape}, (height, width) expected; convert colours to grey "
                         "levels first")
    if not (np.issubdtype(values.dtype, np.integer) or np.issubdtype(values.dtype, np.floating)):
        raise InputError(f"{name}: an array of {values.dtype}, grey levels of an integer or float type expected")
    largest = float(np.iinfo(values.dtype).max) if np.issubdtype(values.dtype, np.integer) else None
    return ArraySource(Path(name), values, largest)


def _check_mask(mask: NDArray[Any], image: ImageSource, name: str) -> NDArray[np.uint8]:
    if mask.shape != (image.height, image.width):
        raise InputError(f"{name}: its mask has shape {mask.shape}, the image ({image.height}, {image.width}); "
                         "give one value for each pixel")
    return np.asarray(mask != 0, dtype=np.uint8)
