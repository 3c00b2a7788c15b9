"""PNG, BMP, JPEG and rarely compressed TIFF files: decoded whole by OpenCV, then cropped."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.images.window import Window
from ddic.io.grey import to_grey
from ddic.io.image_header import check_header
from ddic.io.library_messages import caught_messages
from ddic.io.pixel_format import PixelFormat

_JPEG = b"\xff\xd8\xff"

_DAMAGE = ("Corrupt JPEG data", "Premature end of JPEG file")
"""What libjpeg says of pixels that it could not decode."""

_HARMLESS = "extraneous bytes"
"""What it says too where it lost none."""


def read_decoded_format(path: Path) -> PixelFormat:
    """Read size and type of an image file that OpenCV reads.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    PixelFormat
        Of its pixels.

    Raises
    ------
    InputError
        Where OpenCV does not read it.
    """
    return _format(_decode(path))


def decode_whole(path: Path) -> tuple[PixelFormat, NDArray[Any]]:
    """Decode a whole image.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    layout : PixelFormat
        Size and type of its pixels.
    grey : (height, width) array
        Grey levels.

    Raises
    ------
    InputError
        Where it is unreadable.
    """
    pixels = _decode(path)
    layout = _format(pixels)
    return layout, to_grey(_red_first(pixels, layout), layout.n_colours)


def read_decoded(path: Path, layout: PixelFormat, window: Window) -> NDArray[Any]:
    """Decode an image and keep a window of it.

    Parameters
    ----------
    path : Path
        The file.
    layout : PixelFormat
        What the file held when it was opened.
    window : Window
        Pixels to keep.

    Returns
    -------
    (window.height, window.width) array
        Grey levels.

    Raises
    ------
    InputError
        Where it is unreadable, or has changed.
    """
    pixels = _decode(path)
    if pixels.shape != (layout.height, layout.width, layout.n_channels):
        raise InputError(f"{path}: the file changed while it was in use; keep images fixed during a run")
    part = _red_first(pixels[window.y0:window.y1, window.x0:window.x1], layout)
    # A copy, so that the whole image is released.
    return to_grey(part, layout.n_colours).copy()


def is_jpeg(path: Path) -> bool:
    """Tell whether a file starts as JPEG does.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    bool
        Whether it does.
    """
    with path.open("rb") as stream:
        return stream.read(len(_JPEG)) == _JPEG


def _format(pixels: NDArray[Any]) -> PixelFormat:
    """Size and type of decoded pixels (height, width, n_channels)."""
    height, width, n_channels = pixels.shape
    return PixelFormat(width=width, height=height, dtype=pixels.dtype, bits=8 * pixels.dtype.itemsize,
                       n_colours=1 if n_channels < 3 else 3, n_channels=n_channels)


def _red_first(pixels: NDArray[Any], layout: PixelFormat) -> NDArray[Any]:
    # OpenCV orders colours blue, green, red.
    """The same pixels, colours in the order red, green, blue."""
    return pixels[..., 2::-1] if layout.n_colours == 3 else pixels


def _decode(path: Path) -> NDArray[Any]:
    """All pixels (height, width, n_channels) as OpenCV orders them."""
    check_header(path)
    reason = ""
    with caught_messages() as messages:
        try:
            # Without this flag OpenCV silently cuts 16 bits to 8 and turns colour about.
            pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        except cv2.error as error:
            pixels, reason = None, f" ({error.err or 'OpenCV refuses it'})"
    if pixels is None:
        raise InputError(f"{path}: not an image that can be read, or cut short{reason}; "
                         "give a TIFF, PNG, BMP or JPEG file")
    damage = next((line for line in messages if line.startswith(_DAMAGE) and _HARMLESS not in line), None)
    if damage is not None:
        # The decoder has filled what is missing with grey.
        raise InputError(f"{path}: damaged, or cut short ({damage}); copy or save it again")
    array = np.asarray(pixels)
    return array[..., None] if array.ndim == 2 else _without_equal_colours(array)


def _without_equal_colours(pixels: NDArray[Any]) -> NDArray[Any]:
    """Pixels with one channel in place of three equal ones: OpenCV makes colours of a palette's grey ramp."""
    first = pixels[..., 0]
    if pixels.shape[2] < 3 or not all(np.array_equal(first, pixels[..., other]) for other in (1, 2)):
        return pixels
    return pixels[..., [0, *range(3, pixels.shape[2])]]
