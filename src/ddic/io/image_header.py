"""Headers of PNG, JPEG and BMP files, checked before memory is taken for what they claim."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ddic.errors import InputError

if TYPE_CHECKING:
    from PIL.ImageFile import ImageFile

MOST_PIXELS_ALONG = 1_000_000
"""Columns or rows of an image: ten times those of the largest sensors. A larger value believes more headers."""

PNG, JPEG, BMP = b"\x89PNG", b"\xff\xd8\xff", b"BM"
"""First bytes of the files."""

MOST_PIXELS_DECODED = 1 << 28
"""Pixels of an image that can only be decoded whole, 16,384 x 16,384: it takes seconds, and a byte or more of memory a
pixel. A larger value makes every look at a larger image as slow as that."""

MOST_PIXELS_OF_A_BYTE = {
    # Deflate makes 1032 bytes of one at most, of 8 pixels each where they are black or white.
    PNG: 8 * 1032,
    # A block of 8 x 8 pixels takes a bit at least in the first scan.
    JPEG: 8 * 64,
    # Run lengths: 255 pixels in two bytes.
    BMP: 128,
}
"""The most pixels that a byte can hold, by the file's first bytes."""


def check_header(path: Path) -> None:
    """Check the size that an image claims against the size of its file.

    Raises InputError where the header is damaged, or claims more pixels than the file can hold.
    """
    with path.open("rb") as stream:
        first = stream.read(4)
    magic = next((known for known in MOST_PIXELS_OF_A_BYTE if first.startswith(known)), None)
    if magic is None:
        return
    try:
        # Not Image.open, which takes large images for attacks.
        with _find_reader(magic)(str(path)) as header:
            width, height = header.size
    # Pillow's readers raise anything on a damaged header.
    except Exception as error:
        raise InputError(f"{path}: damaged, or cut short ({error}); copy or save it again") from error
    n_bytes = path.stat().st_size
    if width * height > MOST_PIXELS_OF_A_BYTE[magic] * n_bytes:
        raise InputError(f"{path}: damaged: its header claims {width} x {height} px, which a file of {n_bytes} bytes "
                         "cannot hold; copy or save it again")
    check_claimed_size(path, width, height)
    check_decoded_size(path, width, height)


def _find_reader(magic: bytes) -> type[ImageFile]:
    """Reader of a format's header."""
    # Here, for TIFF files, the usual ones, do without Pillow.
    from PIL.BmpImagePlugin import BmpImageFile
    from PIL.JpegImagePlugin import JpegImageFile
    from PIL.PngImagePlugin import PngImageFile

    readers: dict[bytes, type[ImageFile]] = {PNG: PngImageFile, JPEG: JpegImageFile, BMP: BmpImageFile}
    return readers[magic]


def check_decoded_size(path: Path, width: int, height: int) -> None:
    """Refuse an image that would have to be decoded whole to read any part of it, and is too large for that.

    Raises InputError where it has, as its header says, more than MOST_PIXELS_DECODED.
    """
    if width * height > MOST_PIXELS_DECODED:
        raise InputError(f"{path}: {width} x {height} px in a format that can only be decoded whole, which goes for "
                         f"{MOST_PIXELS_DECODED >> 20} Mi pixels at most; save it as uncompressed TIFF, of which only "
                         "what is needed is read")


def check_claimed_size(path: Path, width: int, height: int) -> None:
    """Refuse an image of a size that no camera gives.

    Raises InputError where a side, as its header says, is longer than MOST_PIXELS_ALONG.
    """
    if max(width, height) > MOST_PIXELS_ALONG:
        raise InputError(f"{path}: its header claims {width} x {height} px; images have {MOST_PIXELS_ALONG} columns "
                         "and rows at most; copy or save it again, if it is not damaged")
