"""Headers of PNG, JPEG and BMP files, checked before memory is taken for what they claim."""

from __future__ import annotations

from pathlib import Path

from PIL.BmpImagePlugin import BmpImageFile
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile

from ddic.errors import InputError

MOST_PIXELS_ALONG = 1_000_000
"""Columns or rows of an image: ten times those of the largest sensors. A larger value believes more headers."""

FORMATS = {
    # Deflate makes 1032 bytes of one at most, of 8 pixels each where they are black or white.
    b"\x89PNG": (PngImageFile, 8 * 1032),
    # A block of 8 x 8 pixels takes a bit at least in the first scan.
    b"\xff\xd8\xff": (JpegImageFile, 8 * 64),
    # Run lengths: 255 pixels in two bytes.
    b"BM": (BmpImageFile, 128),
}
"""Reader of each format's header by the file's first bytes, and the most pixels that a byte can hold."""


def check_header(path: Path) -> None:
    """Check the size that an image claims against the size of its file.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    InputError
        Where the header is damaged, or claims more pixels than the file can hold.
    """
    with path.open("rb") as stream:
        first = stream.read(4)
    found = next((known for magic, known in FORMATS.items() if first.startswith(magic)), None)
    if found is None:
        return
    reader, most_pixels = found
    try:
        # Not Image.open, which takes large images for attacks.
        with reader(str(path)) as header:
            width, height = header.size
    # Pillow's readers raise anything on a damaged header.
    except Exception as error:
        raise InputError(f"{path}: damaged, or cut short ({error}); copy or save it again") from error
    n_bytes = path.stat().st_size
    if width * height > most_pixels * n_bytes:
        raise InputError(f"{path}: damaged: its header claims {width} x {height} px, which a file of {n_bytes} bytes "
                         "cannot hold; copy or save it again")
    check_claimed_size(path, width, height)


def check_claimed_size(path: Path, width: int, height: int) -> None:
    """Refuse an image of a size that no camera gives.

    Parameters
    ----------
    path : Path
        The file.
    width, height : int
        Pixels, as its header says.

    Raises
    ------
    InputError
        Where a side is longer than MOST_PIXELS_ALONG.
    """
    if max(width, height) > MOST_PIXELS_ALONG:
        raise InputError(f"{path}: its header claims {width} x {height} px; images have {MOST_PIXELS_ALONG} columns "
                         "and rows at most; copy or save it again, if it is not damaged")
