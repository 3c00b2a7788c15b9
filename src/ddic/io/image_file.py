"""Image files as sources of windows, what is checked of them, and mask images.

PNG, BMP, JPEG and rarely compressed TIFF files are decoded whole by OpenCV, then cropped. Of a mask image, pixels that
are not zero are used.
"""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.images.binned import ArraySource
from ddic.images.source import ImageSource, SizedImage
from ddic.images.window import Window
from ddic.io.image_formats import (
    PixelFormat,
    can_decode,
    caught_messages,
    describe_other_compression,
    is_tiff,
    read_tiff,
    read_tiff_format,
    to_grey,
)
from ddic.io.image_header import check_header
from ddic.io.input_file import require_file

_JPEG = b"\xff\xd8\xff"

_DAMAGE = ("Corrupt JPEG data", "Premature end of JPEG file")
"""What libjpeg says of pixels that it could not decode."""

_HARMLESS = "extraneous bytes"
"""What it says too where it lost none."""


def read_decoded_format(path: Path) -> PixelFormat:
    """Read size and type of an image file that OpenCV reads; raises InputError where it does not."""
    return _format(_decode(path))


def decode_whole(path: Path) -> tuple[PixelFormat, NDArray[Any]]:
    """Decode a whole image to the size and type of its pixels, and its grey levels, (height, width).

    Raises InputError where it is unreadable.
    """
    pixels = _decode(path)
    layout = _format(pixels)
    return layout, to_grey(_red_first(pixels, layout), layout.n_colours)


def read_decoded(path: Path, layout: PixelFormat, window: Window) -> NDArray[Any]:
    """Decode an image and keep grey levels of a window of it, (window.height, window.width).

    ``layout`` is what the file held when it was opened. Raises InputError where it is unreadable, or has changed.
    """
    pixels = _decode(path)
    if pixels.shape != (layout.height, layout.width, layout.n_channels):
        raise InputError(f"{path}: the file changed while it was in use; keep images fixed during a run")
    part = _red_first(pixels[window.y0:window.y1, window.x0:window.x1], layout)
    # A copy, so that the whole image is released.
    return to_grey(part, layout.n_colours).copy()


def is_jpeg(path: Path) -> bool:
    """Tell whether a file starts as JPEG does."""
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


T = TypeVar("T")


@dataclass(frozen=True)
class ImageFile(SizedImage):
    """An image on disk, read window by window; nothing stays open or in memory between reads.

    Attributes
    ----------
    path : Path
        The file.
    layout : PixelFormat
        Size and type of its pixels.
    windowed : bool
        Only what a window needs is decoded.
    """

    path: Path
    layout: PixelFormat
    windowed: bool

    @cached_property
    def extent(self) -> Window:
        """The box of all its pixels."""
        return Window.of_size(self.layout.width, self.layout.height)

    @property
    def saturation(self) -> float | None:
        """Largest grey level of an integer image, None for a float image."""
        return self.layout.saturation

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the grey levels that ``read`` returns."""
        return np.dtype(np.float32) if self.layout.n_colours == 3 else self.layout.dtype

    def read(self, window: Window) -> NDArray[Any]:
        """Read grey levels of a window, (window.height, window.width), of type ``dtype``.

        Raises ValueError if the window leaves the image or is empty, InputError if the file cannot be decoded.
        """
        self.extent.locate_inside(window)
        reader = read_tiff if self.windowed else read_decoded
        return reader(self.path, self.layout, window)


def open_image(path: Path | str) -> ImageFile:
    """Open a TIFF, PNG, BMP or JPEG file as a grey image in its own type (colour: float32).

    Warns of colour, of a transparency channel and of further pages; none of these is used. Warns of JPEG too. Of a file
    that is read window by window, nothing but the header has been read. Raises InputError if the file is missing or is
    no image that can be read.
    """
    path = Path(path)
    windowed, tiff = _kind(path)
    layout = read_tiff_format(path) if windowed else _explained(path, tiff, read_decoded_format)
    _warn_of_what_is_dropped(path, layout)
    return ImageFile(path, layout, windowed)


def open_decoded(path: Path | str) -> tuple[ImageFile, NDArray[Any] | None]:
    """Open an image as ``open_image`` does, and keep what had to be decoded for that.

    That is all grey levels, (height, width), where the file can only be decoded whole, else None.
    """
    path = Path(path)
    windowed, tiff = _kind(path)
    if windowed:
        return open_image(path), None
    layout, pixels = _explained(path, tiff, decode_whole)
    _warn_of_what_is_dropped(path, layout)
    return ImageFile(path, layout, windowed), pixels


def hold_image(path: Path | str) -> ImageSource:
    """Open an image that is read in many windows: one that can only be decoded whole is decoded once.

    Such a one comes as its pixels in memory, any other as the file. Raises InputError as ``open_image`` does.
    """
    image, pixels = open_decoded(path)
    return image if pixels is None else ArraySource(image.path, pixels, image.saturation)


def _kind(path: Path) -> tuple[bool, bool]:
    """Whether a file can be read window by window, and whether it is a TIFF; raises InputError if it is missing."""
    require_file(path, "image file")
    try:
        tiff = is_tiff(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check its permissions") from error
    # Some compressions need codecs that tifffile lacks: OpenCV decodes those, whole but with all their bits.
    return tiff and can_decode(path), tiff


def compute_sha256(path: Path | str) -> str:
    """Reckon the SHA-256 checksum of a file, in hexadecimal digits."""
    with Path(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _explained(path: Path, tiff: bool, decode: Callable[[Path], T]) -> T:
    """What ``decode`` makes of a file; where it fails on a TIFF, the error says what to do about it."""
    other = describe_other_compression(path) if tiff else None
    if other is not None:
        raise InputError(f"{path}: no codec is installed for the compression of this TIFF ({other}); save it again as "
                         "uncompressed TIFF, or install imagecodecs")
    try:
        return decode(path)
    except InputError as error:
        if not tiff:
            raise
        raise InputError(f"{path}: TIFF that is cut short, or that cannot be decoded here; save it again as "
                         "uncompressed TIFF, or install imagecodecs") from error


def _warn_of_what_is_dropped(path: Path, layout: PixelFormat) -> None:
    """Warn of pages, colours and channels that are not used, and of grey levels that are not the camera's."""
    if is_jpeg(path):
        warnings.warn(f"{path}: JPEG compression changes grey levels, which adds to the noise; save TIFF or PNG where "
                      "you can", stacklevel=3)
    if layout.n_pages > 1:
        warnings.warn(f"{path}: {layout.n_pages} pages, only the first is used", stacklevel=3)
    if layout.inverted:
        warnings.warn(f"{path}: white is stored as zero, grey levels are inverted", stacklevel=3)
    if layout.n_colours == 3:
        warnings.warn(f"{path}: colour image, turned to grey (0.299 R + 0.587 G + 0.114 B)", stacklevel=3)
    if layout.n_channels > layout.n_colours:
        warnings.warn(f"{path}: the alpha (transparency) channel is not used", stacklevel=3)


def read_mask(path: Path, width: int, height: int) -> NDArray[np.bool_]:
    """Read a mask, (height, width): True where the image is not 0, which are the pixels to use.

    ``width`` and ``height`` are those of the image that it belongs to. Raises InputError where the mask cannot be read
    or has another size.
    """
    source = hold_image(path)
    if (source.width, source.height) != (width, height):
        raise InputError(f"{path}: the mask is {source.width}x{source.height} px, but its image is "
                         f"{width}x{height} px; give a mask of the image's size")
    return np.asarray(source.read(source.extent) != 0)
