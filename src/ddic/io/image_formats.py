"""Windows of TIFF files, what a file's header says of its pixels, and grey levels of a colour image's channels.

A file's first page is an image, all of its pages are a volume. Only the strips or tiles under a window are read and
decoded. What C libraries write straight to standard error, past
Python, is caught.
"""

import importlib
import logging
import lzma
import os
import struct
import sys
import tempfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import product
from math import prod
from pathlib import Path
from threading import Lock
from typing import IO, Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.images.window import Window

MOST_PIXELS_ALONG = 1_000_000
"""Columns or rows of an image: ten times those of the largest sensors. A larger value believes more headers."""

MOST_PIXELS_DECODED = 1 << 28
"""Pixels of an image that can only be decoded whole, 16,384 x 16,384: it takes seconds, and a byte or more of memory a
pixel. A larger value makes every look at a larger image as slow as that."""

SAME_SIDE = 1e-3
"""Relative difference of sides up to which a voxel is a cube: a tenth of a voxel over a hundred. A larger value
strains more without a word."""


@dataclass(frozen=True)
class PixelFormat:
    """Size and type of an image's pixels.

    Attributes
    ----------
    width, height : int
        Pixels.
    dtype : dtype
        Type of one channel.
    bits : int
        Used bits of a channel.
    n_colours, n_channels : int
        Colours, 1 (grey) or 3, and these with the channels that come with them (alpha).
    n_pages : int
        Images in the file.
    inverted : bool
        Zero is stored for white.
    is_compressed : bool
        Pixels are decoded as they are read, so that only reading shows whether they can be.
    stored : dtype or None
        Type of grey levels that lie in the file as they are, row after row, in the file's byte order; None of others.
    offsets : sequence of int
        Their first byte in each page that was looked at; empty where they do not lie so.
    """

    width: int
    height: int
    dtype: np.dtype[Any]
    bits: int
    n_colours: int
    n_channels: int
    n_pages: int = 1
    inverted: bool = False
    is_compressed: bool = False
    stored: np.dtype[Any] | None = None
    offsets: Sequence[int] = ()

    @property
    def saturation(self) -> float | None:
        """Largest value that the integer type holds, None for floats."""
        if self.dtype.kind == "f":
            return None
        return float(2 ** (self.bits - (self.dtype.kind == "i")) - 1)


LUMA = (0.299, 0.587, 0.114)


def to_grey(channels: NDArray[Any], n_colours: int) -> NDArray[Any]:
    """Turn the channels of pixels, (height, width, n), into grey levels, (height, width).

    Red, green and blue come first, or grey; what follows is dropped. ``n_colours`` 1 keeps the first channel and its
    type, 3 weighs red, green and blue (ITU-R BT.601) to float32.
    """
    if n_colours == 1:
        return np.ascontiguousarray(channels[..., 0])
    grey = np.zeros(channels.shape[:2])
    for weight, channel in zip(LUMA, range(3), strict=True):
        grey += weight * channels[..., channel]
    return grey.astype(np.float32)


def check_decoded_size(path: Path, *sizes: int) -> None:
    """Refuse an image that has to be decoded whole and has more than MOST_PIXELS_DECODED; raises InputError."""
    if prod(sizes) > MOST_PIXELS_DECODED:
        raise InputError(f"{path}: {' x '.join(map(str, sizes))} px in a format that can only be decoded whole, which "
                         f"goes for {MOST_PIXELS_DECODED >> 20} Mi pixels at most; save it as uncompressed TIFF, of "
                         "which only what is needed is read")


def check_claimed_size(path: Path, *sizes: int) -> None:
    """Refuse an image whose header claims a side longer than MOST_PIXELS_ALONG; raises InputError."""
    if max(sizes) > MOST_PIXELS_ALONG:
        raise InputError(f"{path}: its header claims {' x '.join(map(str, sizes))} px; images have {MOST_PIXELS_ALONG} "
                         "columns and rows at most; copy or save it again, if it is not damaged")


def check_cubes(path: Path, sides: Sequence[float]) -> None:
    """Refuse voxels whose sides, (x, y, z) in any unit, differ by more than SAME_SIDE; raises InputError."""
    if max(sides) - min(sides) > SAME_SIDE * max(sides):
        listed = " x ".join(f"{side:g}" for side in sides)
        raise InputError(f"{path}: voxels of {listed} by its header, cubes expected; resample it, or correct the "
                         "header where that is wrong")


# tifffile tells of damage by its log, beside what it raises; what matters of it is checked here.
logging.getLogger("tifffile").addHandler(logging.NullHandler())

MAGIC = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
BAND_BYTES = 4 << 20
FULL_SCALE = 257
"""Levels of 16 bits in one of 8."""
WHOLE_BITS = (1, 8, 16, 32, 64)
"""Bits of a pixel that tifffile reads by itself."""
OF_OPENCV = (1, 2, 3, 4, 5, 6, 7, 8, 32771, 32773, 32809, 32946, 34676, 34677)
"""Compressions that OpenCV's copy of libtiff has; of some others it makes black pixels without a word."""
GREY, INVERTED_GREY, COLOUR, PALETTE = 1, 0, 2, 3
# What tifffile and its codecs let through on damaged files: they have no common base class.
DECODING_ERRORS = (tifffile.TiffFileError, zlib.error, lzma.LZMAError, struct.error, ValueError, LookupError,
                   TypeError, ArithmeticError, ImportError, RuntimeError, OSError)


def is_tiff(path: Path) -> bool:
    """Tell whether a file starts as TIFF or BigTIFF do."""
    with path.open("rb") as stream:
        return stream.read(4) in MAGIC


def read_tiff_format(path: Path, dim: int = 2) -> PixelFormat:
    """Read size and type of a TIFF file's first page, where ``dim`` is 3 of all pages, from the headers alone.

    Raises InputError if it cannot be used, for pages that are unlike as well, or for voxels that are no cubes.
    """
    with _opened(path) as (tiff, page):
        pages = list(tiff.pages) if dim == 3 else [page]
        for each in pages:
            _check_page(path, each)
            _check_segments(path, tiff, each)
        n_pages = len(tiff.pages)
        offsets: Sequence[int] = [int(each.dataoffsets[0]) for each in pages]
        if dim == 3:
            _check_stack(path, tiff, pages)
            if n_pages == 1:
                offsets = _find_planes(path, tiff, page)
                n_pages = len(offsets)
        colours = 3 if int(page.photometric) == COLOUR else 1
        bits, dtype = int(page.bitspersample), _pixel_type(page)
        levels = _read_palette(page)
        if levels is not None:
            colours = 3 if levels.dtype == np.float32 else 1
            dtype = np.dtype(np.uint8) if colours == 3 else levels.dtype
            bits = 8 * dtype.itemsize
        is_flat = all(map(_lies_together, pages))
        is_plain = is_flat and (page.photometric, page.samplesperpixel) == (GREY, 1)
        return PixelFormat(width=int(page.imagewidth), height=int(page.imagelength),
                           dtype=dtype, bits=bits, n_colours=colours,
                           n_channels=int(page.samplesperpixel), n_pages=n_pages,
                           inverted=int(page.photometric) == INVERTED_GREY,
                           is_compressed=not is_flat,
                           stored=dtype.newbyteorder(tiff.byteorder) if is_plain else None,
                           offsets=offsets if is_plain else ())


def _check_stack(path: Path, tiff: Any, pages: Sequence[Any]) -> None:
    """Refuse pages that are no planes of one volume: unlike, of several channels or times; voxels that are no cubes."""
    first, *others = ((page.imagewidth, page.imagelength, page.dtype, page.bitspersample, page.samplesperpixel,
                       page.photometric, page.compression) for page in pages)
    unlike = next((number for number, other in enumerate(others, start=2) if other != first), None)
    if unlike is not None:
        raise InputError(f"{path}: page {unlike} has another size or type than the first; keep one volume in the file")
    axes = next((series.axes for series in tiff.series if len(series.shape) > 3 and "S" not in series.axes), None)
    if axes is not None:
        raise InputError(f"{path}: a stack of axes {axes}; save one channel and one time alone, of axes ZYX")
    said = tiff.imagej_metadata or {}
    if "spacing" in said:
        along = [pages[0].tags.get(name) for name in ("XResolution", "YResolution")]
        sides = [1.0 if tag is None else tag.value[1] / tag.value[0] for tag in along]
        check_cubes(path, [*sides, float(said["spacing"])])


def _find_planes(path: Path, tiff: Any, page: Any) -> Sequence[int]:
    """First bytes of the planes where one page is described: ImageJ lets all of a large stack follow the first."""
    shape, start = tiff.series[0].shape, int(page.dataoffsets[0])
    if len(shape) != 3 or page.samplesperpixel != 1 or not _lies_together(page):
        return [start]
    size = int(page.imagelength) * int(page.imagewidth) * _pixel_type(page).itemsize
    offsets = range(start, start + shape[0] * size, size)
    if offsets.stop > tiff.filehandle.size:
        raise InputError(f"{path}: cut short, or damaged: its header claims {shape[0]} pages, which the "
                         f"{tiff.filehandle.size} bytes of the file do not hold; copy or save it again")
    return offsets


def can_decode(path: Path) -> bool:
    """Tell whether tifffile has the codecs, here, that the compression of a TIFF file's first page needs."""
    with _opened(path) as (_, page):
        try:
            if page.compression != 1:
                _require_codec(tifffile.TIFF.DECOMPRESSORS[page.compression])
            if page.predictor != 1:
                tifffile.TIFF.UNPREDICTORS[page.predictor]
            if page.bitspersample not in WHOLE_BITS:
                # Numbers of other bits, packed, are unpacked by a package that need not be there.
                importlib.import_module("imagecodecs")
        except (KeyError, ImportError):
            return False
        return True


def _require_codec(decompress: Callable[..., Any]) -> None:
    """Raise ImportError where a codec lacks a package, for which some look only when they decode."""
    with suppress(*(kind for kind in DECODING_ERRORS if kind is not ImportError)):
        decompress(b"")


def describe_other_compression(path: Path) -> str | None:
    """Name the compression of the first page, which is to be decoded whole, where OpenCV has no codec for it.

    It is named as TIFF names it, or by its number; None where OpenCV decodes it. Raises InputError where the page is
    too large to be decoded whole.
    """
    with _opened(path) as (_, page):
        check_decoded_size(path, int(page.imagewidth), int(page.imagelength))
        known = int(page.compression) in OF_OPENCV
        return None if known else str(getattr(page.compression, "name", page.compression))


def read_tiff(path: Path, layout: PixelFormat, window: Window) -> NDArray[Any]:
    """Read grey levels of a window of the first page, or of a box of the pages, an array of its shape.

    ``layout`` is that of the first page. Raises InputError if a segment is cut short or cannot be decoded.
    """
    with _opened(path) as (tiff, page):
        if len(window.lower) == 2:
            return _read_page(tiff, page, layout, window)
        plane = Window(window.lower[:2], window.upper[:2])
        return np.stack([_read_page(tiff, tiff.pages[number], layout, plane)
                         for number in range(window.lower[2], window.upper[2])])


def _read_page(tiff: Any, page: Any, layout: PixelFormat, window: Window) -> NDArray[Any]:
    """Grey levels of a window of one page."""
    out = np.empty(window.shape, np.float32 if layout.n_colours == 3 else layout.dtype)
    levels = _read_palette(page)
    for block, x, y in _blocks(tiff, page, layout, window):
        part = window.intersection(Window((x, y), (x + block.shape[1], y + block.shape[0])))
        pixels = block[part.y0 - y:part.y1 - y, part.x0 - x:part.x1 - x]
        out[window.locate(part)] = to_grey(pixels, layout.n_colours) if levels is None else levels[pixels[..., 0]]
    return np.subtract(2 ** layout.bits - 1, out, dtype=out.dtype) if layout.inverted else out


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, Any]]:
    """The open file and its first page; what damage makes tifffile raise inside becomes an InputError."""
    try:
        with tifffile.TiffFile(path) as tiff:
            yield tiff, tiff.pages[0]
    except DECODING_ERRORS as error:
        raise InputError(f"{path}: damaged, or no TIFF that can be decoded ({error}); "
                         "save it again as uncompressed TIFF") from error


def _check_page(path: Path, page: Any) -> None:
    """Refuse pages that hold no grey levels or colours."""
    if int(page.photometric) not in (INVERTED_GREY, GREY, COLOUR, PALETTE, 6):
        raise InputError(f"{path}: TIFF of kind {page.photometric!s} (a colour space); save it as a grey image")
    if page.dtype is None or page.dtype.kind not in "buif":
        raise InputError(f"{path}: pixels of type {page.dtype} cannot be used; save 8 or 16 bit, or float32")
    if page.imagedepth != 1:
        raise InputError(f"{path}: a page of {page.imagedepth} planes; save each plane as a page of its own")
    if page.imagewidth < 1 or page.imagelength < 1 or not page.dataoffsets:
        raise InputError(f"{path}: the TIFF file holds no pixels; save it again")
    if int(page.photometric) == INVERTED_GREY and page.dtype.kind not in "bu":
        raise InputError(f"{path}: white-is-zero TIFF with {page.dtype} pixels; save it as black-is-zero")


def _check_segments(path: Path, tiff: Any, page: Any) -> None:
    """Refuse a file without all the strips or tiles that its first page claims."""
    height, width = int(page.imagelength), int(page.imagewidth)
    check_claimed_size(path, width, height)
    starts, counts = np.asarray(page.dataoffsets, np.float64), np.asarray(page.databytecounts, np.float64)
    size = tiff.filehandle.size
    if _lies_together(page):
        # Counts are wrong in some files that can be read all the same.
        n_bytes = height * width * int(page.samplesperpixel) * _pixel_type(page).itemsize
        is_whole = starts[0] + n_bytes <= size
    else:
        rows, columns = _segment_size(page)
        n_planes = int(page.samplesperpixel) if page.planarconfig == 2 else 1
        n_segments = -(-height // rows) * -(-width // columns) * n_planes
        is_whole = n_segments <= len(starts) == len(counts) and bool(((starts + counts)[counts > 0] <= size).all())
    if not is_whole:
        raise InputError(f"{path}: cut short, or damaged: its header claims {width} x {height} px, which the {size} "
                         "bytes of the file do not hold; copy or save it again")


def _segment_size(page: Any) -> tuple[int, int]:
    """Rows and columns of a strip or a tile."""
    return (page.tilelength, page.tilewidth) if page.is_tiled else (page.rowsperstrip, page.imagewidth)


def _read_bytes(tiff: Any, offset: int, n_bytes: int) -> bytes:
    """Bytes of an open file; raises ValueError where they are not all there."""
    tiff.filehandle.seek(offset)
    data: bytes = tiff.filehandle.read(n_bytes)
    if len(data) < n_bytes:
        raise ValueError("the file is cut short")
    return data


def _lies_together(page: Any) -> bool:
    """Whether pixels of whole bytes lie together, row by row."""
    bits_are_whole = page.bitspersample == 8 * _pixel_type(page).itemsize
    return bool(page.is_contiguous and bits_are_whole and page.planarconfig == 1)


def _read_palette(page: Any) -> NDArray[Any] | None:
    """Grey level of each number of a palette: whole levels where all its colours are grey; None without a palette."""
    if int(page.photometric) != PALETTE:
        return None
    colours = np.asarray(page.colormap, dtype=np.uint16)
    if (colours != colours[0]).any():
        by_number = colours.T[None] / FULL_SCALE
        return to_grey(by_number, 3).ravel()
    grey: NDArray[np.uint16] = colours[0]
    # A palette's levels have 16 bits: those of 8 are stored as 257 or 256 times as much.
    of_8_bits = ((grey % FULL_SCALE == 0) | (grey % 256 == 0)).all()
    return (grey >> 8).astype(np.uint8) if of_8_bits else grey


def _pixel_type(page: Any) -> np.dtype[Any]:
    """Type of a channel in memory, in the machine's byte order."""
    return np.dtype(np.uint8) if page.dtype.kind == "b" else np.dtype(page.dtype).newbyteorder("=")


def _blocks(tiff: Any, page: Any, layout: PixelFormat, window: Window) -> Iterator[tuple[NDArray[Any], int, int]]:
    """Blocks of pixels (rows, columns, channels) over the window, each with its first column and row."""
    if _lies_together(page):
        yield from _bands(tiff, page, layout, window)
        return
    # Colours may lie in planes apart.
    n_planes = 1 if page.planarconfig == 1 else layout.n_channels
    per_plane = len(page.dataoffsets) // n_planes
    planes = [_segments(tiff, page, window, range(c * per_plane, (c + 1) * per_plane))
              for c in range(min(n_planes, layout.n_colours))]
    for parts in zip(*planes, strict=True):
        yield np.concatenate([block for block, _, _ in parts], axis=-1), parts[0][1], parts[0][2]


def _bands(tiff: Any, page: Any, layout: PixelFormat, window: Window) -> Iterator[tuple[NDArray[Any], int, int]]:
    """Rows of the window, read straight from pixels that lie together."""
    stored = _pixel_type(page).newbyteorder(tiff.byteorder)
    row_bytes = layout.width * layout.n_channels * stored.itemsize
    rows_at_once = max(1, BAND_BYTES // row_bytes)
    for y in range(window.y0, window.y1, rows_at_once):
        n_rows = min(rows_at_once, window.y1 - y)
        data = _read_bytes(tiff, page.dataoffsets[0] + y * row_bytes, n_rows * row_bytes)
        yield np.frombuffer(data, stored).reshape(n_rows, layout.width, layout.n_channels), 0, y


def _segments(tiff: Any, page: Any, window: Window, numbers: range) -> Iterator[tuple[NDArray[Any], int, int]]:
    """Strips or tiles under the window, decoded one by one; numbers: of those of one plane."""
    height, width = _segment_size(page)
    n_columns = -(-page.imagewidth // width)
    places = product(range(window.y0 // height, -(-window.y1 // height)),
                     range(window.x0 // width, -(-window.x1 // width)))
    for row, column in places:
        number, x, y = numbers[row * n_columns + column], column * width, row * height
        n_bytes = page.databytecounts[number]
        data = _read_bytes(tiff, page.dataoffsets[number], n_bytes) if n_bytes else None
        pixels, _, shape = page.decode(data, number)
        block = np.full(shape, page.nodata, page.dtype) if pixels is None else pixels
        yield block[0], x, y


STANDARD_ERROR = 2

_LOCK = Lock()


@contextmanager
def caught_messages() -> Iterator[list[str]]:
    """Catch lines that are written to standard error inside; the list has them, blank ones left out, on the way out."""
    lines: list[str] = []
    with _LOCK, _open_scratch() as caught:
        sys.stderr.flush()
        try:
            kept = os.dup(STANDARD_ERROR)
        except OSError:
            # Closed: nothing is to be seen of it anyway.
            yield lines
            return
        os.dup2(caught.fileno(), STANDARD_ERROR)
        try:
            yield lines
        finally:
            sys.stderr.flush()
            os.dup2(kept, STANDARD_ERROR)
            os.close(kept)
            caught.seek(0)
            lines += [line for line in caught.read().decode(errors="replace").splitlines() if line.strip()]


def _open_scratch() -> IO[bytes]:
    """A file of no folder: what is decoded may be all that a full disk has room for."""
    if hasattr(os, "memfd_create"):
        return os.fdopen(os.memfd_create("messages"), "w+b")
    return tempfile.TemporaryFile()
