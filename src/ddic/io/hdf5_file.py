"""HDF5 files that may be damaged, and disks that may be full.

A file is opened where the library does not turn in a loop over it, and closed whatever the disk has refused. Chunks of
the residual image: their places in the image, and their bytes on disk.
"""

import io
import mmap
import os
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.images.window import Window

Arrays = Mapping[str, NDArray[Any]]

READ_ERRORS = (OSError, RuntimeError, KeyError, ValueError, IndexError, TypeError, AttributeError, ArithmeticError,
               MemoryError)
"""What HDF5, h5py and numpy raise on damaged files; h5py passes on most of HDF5's own as RuntimeError."""

MOST_DEFLATED = 1100
"""Bytes that a byte of a compressed dataset can stand for: deflate's limit is 1032."""


def describe_damage(error: BaseException) -> str:
    """Say in a line what could not be read: the first line of an error's message, or its kind where it has none.

    ``error`` is one of READ_ERRORS.
    """
    message = str(error.args[0] if isinstance(error, KeyError) and error.args else error).strip()
    return message.splitlines()[0] if message else type(error).__name__


def read_array(dataset: Any) -> NDArray[Any]:
    """Read a dataset whole, unless it claims to hold more than its file can.

    The file may be damaged. Raises ValueError, with both sizes, where memory would be filled with what is not there.
    """
    # A file in memory was written by this program from what was read before.
    if dataset.file.driver != "core":
        stored = min(dataset.id.get_storage_size(), dataset.file.id.get_filesize())
        if dataset.nbytes > stored * (MOST_DEFLATED if dataset.compression else 1):
            raise ValueError(f"{dataset.name} claims {dataset.nbytes} bytes, of which {stored} are there")
    return np.asarray(dataset[...])


_Extent = tuple[int, int]
"""First byte and the one behind the last."""

_SIGNATURE = b"GCOL\x01\x00\x00\x00"
"""Of a global heap collection, which holds texts of variable length: HDF5 File Format Specification, section III.E."""

_HEADER, _OBJECT = struct.Struct("<8sQ"), struct.Struct("<HHIQ")
"""Signature and size of a collection; number, references, nothing and size of an object in it."""


def open_hdf5(path: Path) -> h5py.File:
    """Open an HDF5 file for reading; the caller closes it.

    The library reads a collection of texts object by object, and stays for ever at one of no size: where a disk has
    left zeros, no time limit in this process ends it. All else that is damaged the library finds by itself. Hence
    collections are looked through here, in what of the file is no array: a few hundred kilobytes of any result.

    Raises InputError where a collection would hold the library for ever, or the objects of the file cannot be listed;
    OSError where it cannot be opened, or is no HDF5 file.
    """
    with ExitStack() as stack:
        file = stack.enter_context(h5py.File(path, "r"))
        _require_finite(path, file)
        stack.pop_all()
    return file


def _require_finite(path: Path, file: h5py.File) -> None:
    """Raise InputError for a file that cannot be read to its end."""
    try:
        is_endless = _is_endless(path, file)
    except (RuntimeError, KeyError, ValueError) as error:
        # What h5py makes of objects that cannot be visited.
        raise InputError(f"{path}: damaged ({error}); write it anew, or take a copy") from error
    if is_endless:
        raise InputError(f"{path}: damaged: a part of it was overwritten (an HDF5 heap with an object of no size); "
                         "write it anew, or take a copy")


def _is_endless(path: Path, file: h5py.File) -> bool:
    """Whether one of the collections of a file has an object of no size."""
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
        for begin, end in _find_gaps(_list_arrays(file), len(content)):
            place = content.find(_SIGNATURE, begin, end)
            while place >= 0:
                if _has_object_of_no_size(content, place):
                    return True
                place = content.find(_SIGNATURE, place + 1, end)
    return False


def _has_object_of_no_size(content: mmap.mmap, place: int) -> bool:
    """Whether a collection has one; what else is wrong with it the library finds."""
    if place + _HEADER.size > len(content):
        return False
    _, size = _HEADER.unpack_from(content, place)
    at, end = place + _HEADER.size, min(place + size, len(content))
    while at + _OBJECT.size <= end:
        number, _, _, size = _OBJECT.unpack_from(content, at)
        # The size of number 0, which is free space, includes its header.
        step = size if number == 0 else _OBJECT.size + -(-size // 8) * 8
        if step == 0:
            return True
        at += step
    return False


def _list_arrays(file: h5py.File) -> list[_Extent]:
    """Where the arrays of a file are."""
    extents: list[_Extent] = []

    def add(name: str, item: object) -> None:
        if not isinstance(item, h5py.Dataset):
            return
        start = item.id.get_offset()
        if start is not None:
            extents.append((start, start + item.id.get_storage_size()))
        elif item.chunks is not None:
            item.id.chunk_iter(lambda chunk: extents.append((chunk.byte_offset, chunk.byte_offset + chunk.size)))

    file.visititems(add)
    return sorted(extents)


def _find_gaps(extents: list[_Extent], size: int) -> Iterator[_Extent]:
    """Find what lies between the arrays of a file."""
    at = 0
    for start, end in (*extents, (size, size)):
        if start > at:
            yield at, min(start, size)
        at = max(at, end)


class _UnfailingFile(io.RawIOBase):
    """A file that takes every write: what the disk refuses stays in memory, and why is kept.

    The HDF5 library cannot close a file that a disk refuses: it tries again when the process ends, and crashes. Here it
    never sees a failure, closes as it always does, and whoever writes asks for the error afterwards, or in between so
    that little is kept in memory.

    ``path`` is an existing file, which is emptied; ``error`` is that of the first write that was refused, or None.
    """

    def __init__(self, path: Path) -> None:
        self.error: OSError | None = None
        self._path = path
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o666)
        self._place = 0
        self._size = 0
        self._refused: dict[int, bytes] = {}

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a place, and return it in bytes from the beginning."""
        start = {os.SEEK_SET: 0, os.SEEK_CUR: self._place, os.SEEK_END: self._size}[whence]
        self._place = start + offset
        return self._place

    def write(self, data: Any) -> int:
        """Write all data where the file stands, and return their length."""
        view = memoryview(data).cast("B")
        if self.error is None:
            try:
                self._write_through(view)
            except OSError as error:
                self.error = OSError(error.errno, error.strerror, str(self._path))
        if self.error is not None:
            self._refused[self._place] = bytes(view)
        self._place += len(view)
        self._size = max(self._size, self._place)
        return len(view)

    def _write_through(self, view: memoryview) -> None:
        done = 0
        while done < len(view):
            done += os.pwrite(self._descriptor, view[done:], self._place + done)

    def readinto(self, buffer: Any) -> int:
        """Fill the buffer from where the file stands, with zeros where nothing was written, and return its length."""
        view = memoryview(buffer).cast("B")
        found = os.pread(self._descriptor, len(view), self._place)
        view[:] = found.ljust(len(view), b"\0")
        for start, kept in self._refused.items():
            begin, end = max(start, self._place), min(start + len(kept), self._place + len(view))
            if begin < end:
                view[begin - self._place:end - self._place] = kept[begin - start:end - start]
        self._place += len(view)
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        """Cut the file, or make it longer, and return its size, bytes; by default where the file stands."""
        self._size = self._place if size is None else size
        if self.error is None:
            try:
                os.ftruncate(self._descriptor, self._size)
            except OSError as error:
                self.error = OSError(error.errno, error.strerror, str(self._path))
        return self._size

    def require_written(self) -> None:
        """Raise an OSError where the disk has not taken everything so far."""
        if self.error is not None:
            raise self.error

    def close(self) -> None:
        """Close the file."""
        if not self.closed:
            os.close(self._descriptor)
        super().close()


@contextmanager
def new_hdf5(path: Path, cache_bytes: int | None = None) -> Iterator[tuple[h5py.File, Callable[[], None]]]:
    """Yield an HDF5 file to be written, which is closed whatever the disk does.

    Beside it comes what raises an OSError where the disk has not taken everything so far; so it is at the end. ``path``
    is an existing file, which is emptied; ``cache_bytes`` are for chunks of datasets.
    """
    stream = _UnfailingFile(path)
    try:
        with stream, h5py.File(stream, "w", rdcc_nbytes=cache_bytes) as file:
            yield file, stream.require_written
    except Exception:
        # What else went wrong comes of what the disk has refused.
        stream.require_written()
        raise
    stream.require_written()


IMAGE_CHUNK = 256
"""Side of a chunk, pixels."""

NOISE_BITS = 7.8
"""Bits per byte above which a plane is stored as it is: compression would gain less than 3 %."""

RUN_BITS = 2.0
"""Bits per byte below which a plane is searched for repetitions; else its bytes are only coded by their frequency,
which on grey levels gains as much in a third of the time, and by runs of one byte where pixels are missing."""

SAMPLING = 5
"""One byte in so many is looked at; odd, so that all columns of a chunk are."""

ZLIB_HEADER = b"\x78\x01"


@dataclass(frozen=True)
class ChunkGrid:
    """Chunks of an image, numbered row by row; those at the right and lower edges reach beyond the image.

    Attributes
    ----------
    width, height : int
        Of the image, pixels.
    """

    width: int
    height: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of pixels of a chunk."""
        return min(IMAGE_CHUNK, self.height), min(IMAGE_CHUNK, self.width)

    @property
    def n_columns(self) -> int:
        """Number of chunks side by side."""
        return -(-self.width // self.shape[1])

    def locate_chunk(self, number: int) -> Window:
        """Tell which pixels a chunk has, those beyond the image included."""
        rows, columns = self.shape
        row, column = divmod(number, self.n_columns)
        return Window((column * columns, row * rows), ((column + 1) * columns, (row + 1) * rows))

    def find_chunks(self, window: Window) -> list[int]:
        """Find the chunks that share pixels with a window, sorted; pixels beyond the image do not count."""
        rows, columns = self.shape
        part = window.intersection(Window.of_size(self.width, self.height))
        if part.n_pixels == 0:
            return []
        return [row * self.n_columns + column
                for row in range(part.y0 // rows, (part.y1 - 1) // rows + 1)
                for column in range(part.x0 // columns, (part.x1 - 1) // columns + 1)]


def pack_chunk(chunk: NDArray[np.float32]) -> bytes:
    """Pack a chunk as HDF5's shuffle and deflate filters would store it, to a zlib stream.

    The bytes of equal weight lie together (shuffle). Each of these planes is a piece of one zlib stream by itself,
    since the low bytes of a residual are noise on which every search for repetitions is lost time. The chunk, (rows,
    columns), holds grey levels, nan where not correlated.
    """
    planes = np.ascontiguousarray(chunk.astype("<f4", copy=False).reshape(-1).view(np.uint8).reshape(-1, 4).T)
    last = len(planes) - 1
    has_runs = bool(np.isnan(chunk).any())
    pieces = [_deflated(plane, has_runs=has_runs, last=k == last) for k, plane in enumerate(planes)]
    return b"".join([ZLIB_HEADER, *pieces, zlib.adler32(planes.tobytes()).to_bytes(4, "big")])


def _deflated(plane: NDArray[np.uint8], *, has_runs: bool, last: bool) -> bytes:
    """A plane of bytes as a piece of a deflate stream; has_runs: pixels are missing; last: end the stream."""
    bits = _bits_per_byte(plane[::SAMPLING])
    level = 0 if bits > NOISE_BITS else 1
    otherwise = zlib.Z_DEFAULT_STRATEGY if bits < RUN_BITS else zlib.Z_HUFFMAN_ONLY
    # All bytes of missing pixels are the same, and other repetitions are chance.
    strategy = zlib.Z_RLE if has_runs else otherwise
    deflate = zlib.compressobj(level, zlib.DEFLATED, -zlib.MAX_WBITS, zlib.DEF_MEM_LEVEL, strategy)
    # A flushed piece ends on a byte, so that the next one can follow it in the same stream.
    return deflate.compress(plane.tobytes()) + deflate.flush(zlib.Z_FINISH if last else zlib.Z_SYNC_FLUSH)


def _bits_per_byte(values: NDArray[np.uint8]) -> float:
    """Entropy of the bytes' frequencies."""
    share = np.bincount(values, minlength=256) / len(values)
    share = share[share > 0]
    return float(-(share * np.log2(share)).sum())
