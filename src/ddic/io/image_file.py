"""Image files as sources of windows, and what is checked of them.

PNG, BMP, JPEG and rarely compressed TIFF files are decoded whole by OpenCV, then cropped.
"""

import hashlib
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.images.source import SizedImage
from ddic.images.window import Window
from ddic.io import image_formats as formats
from ddic.io.image_formats import PixelFormat
from ddic.io.input_file import require_file

PNG, JPEG, BMP = b"\x89PNG", b"\xff\xd8\xff", b"BM"
"""First bytes of the files."""

MOST_PIXELS_OF_A_BYTE = {
    # Deflate makes 1032 bytes of one at most, of 8 pixels each where they are black or white.
    PNG: 8 * 1032,
    # A block of 8 x 8 pixels takes a bit at least in the first scan.
    JPEG: 8 * 64,
    # Run lengths: 255 pixels in two bytes.
    BMP: 128,
}
"""The most pixels that a byte can hold, by the file's first bytes."""

_DAMAGE = ("Corrupt JPEG data", "Premature end of JPEG file")
"""What libjpeg says of pixels that it could not decode."""

_HARMLESS = "extraneous bytes"
"""What it says too where it lost none."""


def _read_decoded(path: Path, layout: PixelFormat, window: Window) -> NDArray[Any]:
    """Decode an image and keep grey levels of a window of it, (window.height, window.width).

    ``layout`` is what the file held when it was opened. Raises InputError where it is unreadable, or has changed.
    """
    pixels = _decode(path)
    if pixels.shape != (layout.height, layout.width, layout.n_channels):
        raise InputError(f"{path}: the file changed while it was in use; keep images fixed during a run")
    # A copy, so that the whole image is released.
    return _convert_to_grey(pixels[window.y0:window.y1, window.x0:window.x1], layout).copy()


def _format(pixels: NDArray[Any]) -> PixelFormat:
    """Size and type of decoded pixels (height, width, n_channels)."""
    height, width, n_channels = pixels.shape
    return PixelFormat(width=width, height=height, dtype=pixels.dtype, bits=8 * pixels.dtype.itemsize,
                       n_colours=1 if n_channels < 3 else 3, n_channels=n_channels)


def _convert_to_grey(pixels: NDArray[Any], layout: PixelFormat) -> NDArray[Any]:
    """Grey levels (height, width) of decoded pixels."""
    # OpenCV orders colours blue, green, red.
    red_first = pixels[..., 2::-1] if layout.n_colours == 3 else pixels
    return formats.to_grey(red_first, layout.n_colours)


def _decode(path: Path) -> NDArray[Any]:
    """All pixels (height, width, n_channels) as OpenCV orders them."""
    _check_header(path)
    reason = ""
    with formats.caught_messages() as messages:
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


def _check_header(path: Path) -> tuple[int, int, str] | None:
    """Width, height and mode that a header says; None without one that is known.

    Raises InputError where it is damaged, or claims more pixels than the file can hold.
    """
    magic = _find_magic(path)
    if magic is None:
        return None
    try:
        # Not Image.open, which takes large images for attacks.
        with _find_reader(magic)(str(path)) as header:
            width, height = header.size
            mode = str(header.mode)
    # Pillow's readers raise anything on a damaged header.
    except Exception as error:
        raise InputError(f"{path}: damaged, or cut short ({error}); copy or save it again") from error
    n_bytes = path.stat().st_size
    if width * height > MOST_PIXELS_OF_A_BYTE[magic] * n_bytes:
        raise InputError(f"{path}: damaged: its header claims {width} x {height} px, which a file of {n_bytes} bytes "
                         "cannot hold; copy or save it again")
    formats.check_claimed_size(path, width, height)
    formats.check_decoded_size(path, width, height)
    return width, height, mode


def _find_magic(path: Path) -> bytes | None:
    """The first bytes of a file, where they are those of PNG, JPEG or BMP."""
    with path.open("rb") as stream:
        first = stream.read(4)
    return next((known for known in MOST_PIXELS_OF_A_BYTE if first.startswith(known)), None)


def _find_reader(magic: bytes) -> Callable[[str], Any]:
    """Reader of a format's header."""
    # Here, for TIFF files, the usual ones, do without Pillow.
    from PIL.BmpImagePlugin import BmpImageFile
    from PIL.JpegImagePlugin import JpegImageFile
    from PIL.PngImagePlugin import PngImageFile

    readers: dict[bytes, Callable[[str], Any]] = {PNG: PngImageFile, JPEG: JpegImageFile, BMP: BmpImageFile}
    return readers[magic]


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
        reader = formats.read_tiff if self.windowed else _read_decoded
        return reader(self.path, self.layout, window)


def open_image(path: Path | str) -> ImageFile:
    """Open a TIFF, PNG, BMP or JPEG file as a grey image in its own type (colour: float32).

    Warns of colour, of a transparency channel and of further pages; none of these is used. Warns of JPEG too. Of a file
    that is read window by window, nothing but the header has been read. Raises InputError if the file is missing or is
    no image that can be read.
    """
    return _open(Path(path))[0]


def open_decoded(path: Path | str) -> tuple[ImageFile, NDArray[Any] | None]:
    """Open an image as ``open_image`` does, and keep what had to be decoded for that.

    That is all grey levels, (height, width), where the file can only be decoded whole, else None.
    """
    image, pixels = _open(Path(path))
    return image, None if pixels is None else _convert_to_grey(pixels, image.layout)


def open_slices(files: Sequence[Path]) -> list[ImageFile]:
    """Open images of one size and type by their headers; the first one as ``open_image`` does.

    Raises InputError for one that is missing, damaged, or unlike the first.
    """
    first, expected = open_image(files[0]), None
    slices = []
    for file in files:
        layout = formats.read_tiff_format(file) if formats.is_tiff(file) else None
        header = replace(layout, stored=None, offsets=(), is_compressed=False) if layout else _check_header(file)
        expected = expected or header
        if header != expected:
            raise InputError(f"{file}: another size or type than {files[0].name}; keep slices of one volume alone in "
                             "the folder")
        slices.append(ImageFile(file, layout or first.layout, first.windowed))
    return slices


def _open(path: Path) -> tuple[ImageFile, NDArray[Any] | None]:
    """An image, and its decoded pixels where the file cannot be read window by window."""
    require_file(path, "image file")
    try:
        tiff = formats.is_tiff(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check its permissions") from error
    # Some compressions need codecs that tifffile lacks: OpenCV decodes those, whole but with all their bits.
    windowed = tiff and formats.can_decode(path)
    pixels = None
    if windowed:
        layout = formats.read_tiff_format(path)
    else:
        pixels = _decode_tiff(path) if tiff else _decode(path)
        layout = _format(pixels)
    _warn_of_what_is_dropped(path, layout)
    return ImageFile(path, layout, windowed), pixels


def compute_sha256(path: Path | str) -> str:
    """Reckon the SHA-256 checksum of a file, in hexadecimal digits."""
    with Path(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _decode_tiff(path: Path) -> NDArray[Any]:
    """All pixels of a TIFF as OpenCV orders them; where there are none, the error says what to do about it."""
    other = formats.describe_other_compression(path)
    if other is not None:
        raise InputError(f"{path}: no codec is installed for the compression of this TIFF ({other}); save it again as "
                         "uncompressed TIFF, or install imagecodecs")
    try:
        return _decode(path)
    except InputError as error:
        raise InputError(f"{path}: TIFF that is cut short, or that cannot be decoded here; save it again as "
                         "uncompressed TIFF, or install imagecodecs") from error


def _warn_of_what_is_dropped(path: Path, layout: PixelFormat) -> None:
    """Warn of pages, colours and channels that are not used, and of grey levels that are not the camera's."""
    dropped = {
        "JPEG compression changes grey levels, which adds to the noise; save TIFF or PNG where you can":
            _find_magic(path) == JPEG,
        f"{layout.n_pages} pages, only the first is used; name a volume in [volumes]": layout.n_pages > 1,
        "white is stored as zero, grey levels are inverted": layout.inverted,
        "colour image, turned to grey (0.299 R + 0.587 G + 0.114 B)": layout.n_colours == 3,
        "the alpha (transparency) channel is not used": layout.n_channels > layout.n_colours,
    }
    for message, applies in dropped.items():
        if applies:
            # Told of the line that opens the image.
            warnings.warn(f"{path}: {message}", stacklevel=4)
