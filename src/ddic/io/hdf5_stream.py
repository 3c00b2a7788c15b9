"""HDF5 files on disks that may be full.

Chunks of the residual image: their places in the image, and their bytes on disk.
"""

import io
import os
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ddic.images.window import Window


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
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
            self._refused = {}
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
        return Window(column * columns, row * rows, (column + 1) * columns, (row + 1) * rows)

    def find_chunks(self, window: Window) -> list[int]:
        """Find the chunks that share pixels with a window, sorted; pixels beyond the image do not count."""
        rows, columns = self.shape
        part = window.clip(self.width, self.height)
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
