"""HDF5 files under construction, on disks that may be full, or in memory.

The library closes them whatever the disk has refused. Of a large array it is told the place alone: whoever has the
values, another process perhaps, writes them there.
"""

import io
import os
from abc import abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from numpy.typing import DTypeLike, NDArray

_RESERVED = os.urandom(16)
"""How content begins in whose place somebody else writes; no other content does."""


class Block(NamedTuple):
    """Bytes of a file, from a place on.

    Attributes
    ----------
    place : int
        Of the first byte.
    data : bytes or array
        Of any shape, in the order of memory.
    """

    place: int
    data: bytes | memoryview | NDArray[Any]

    def get_bytes(self) -> memoryview:
        """Get the data byte by byte."""
        return np.frombuffer(self.data, np.uint8).data


def write_block(descriptor: int, block: Block) -> None:
    """Write a block to an open file; raises OSError where the disk does not take all of it."""
    view, done = block.get_bytes(), 0
    while done < len(view):
        done += os.pwrite(descriptor, view[done:], block.place + done)


class _NewFile(io.RawIOBase):
    """What the library writes and reads again; a reserved chunk is not written, and ``reserved`` is its place.

    ``error`` is that of the first write that the disk refused, or None.
    """

    def __init__(self) -> None:
        self.error: OSError | None = None
        self.reserved = 0
        self._place = 0
        self._size = 0

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a place, and return it in bytes from the beginning."""
        start = {os.SEEK_SET: 0, os.SEEK_CUR: self._place, os.SEEK_END: self._size}[whence]
        self._place = start + offset
        return self._place

    def write(self, data: Any) -> int:
        """Write all data where the file stands, and return their length."""
        view = memoryview(data).cast("B")
        if view[:len(_RESERVED)] == _RESERVED:
            self.reserved = self._place
        else:
            self._put(Block(self._place, view))
        self._place += len(view)
        self._size = max(self._size, self._place)
        return len(view)

    def readinto(self, buffer: Any) -> int:
        """Fill the buffer from where the file stands, with zeros where nothing was written, and return its length."""
        view = memoryview(buffer).cast("B")
        self._get(view)
        self._place += len(view)
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        """Cut the file, or make it longer, and return its size, bytes; by default where the file stands."""
        self._size = self._place if size is None else size
        self._resize()
        return self._size

    def require_written(self) -> None:
        """Raise an OSError where the disk has not taken everything so far."""
        if self.error is not None:
            raise self.error

    @abstractmethod
    def write_past_library(self, block: Block) -> None:
        """Write a block where the library has made room; raises OSError where the disk refuses it."""

    @abstractmethod
    def _put(self, block: Block) -> None: ...

    @abstractmethod
    def _get(self, view: memoryview) -> None: ...

    @abstractmethod
    def _resize(self) -> None: ...


class _MemoryFile(_NewFile):
    """A file in memory."""

    def __init__(self) -> None:
        super().__init__()
        self.content = bytearray()

    def write_past_library(self, block: Block) -> None:
        self._put(block)

    def _put(self, block: Block) -> None:
        view = block.get_bytes()
        self.content.extend(bytes(max(0, block.place - len(self.content))))
        self.content[block.place:block.place + len(view)] = view

    def _get(self, view: memoryview) -> None:
        view[:] = self.content[self._place:self._place + len(view)].ljust(len(view), b"\0")

    def _resize(self) -> None:
        del self.content[self._size:]
        self.content.extend(bytes(self._size - len(self.content)))


class _UnfailingFile(_NewFile):
    """A file that takes every write of the library: what the disk refuses stays in memory, and why is kept.

    The HDF5 library cannot close a file that a disk refuses: it tries again when the process ends, and crashes. Here it
    never sees a failure, closes as it always does, and whoever writes asks for the error afterwards, or in between so
    that little is kept in memory. ``path`` is an existing file, which is emptied.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = path
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o666)
        self._refused: dict[int, bytes] = {}

    def write_past_library(self, block: Block) -> None:
        try:
            write_block(self._descriptor, block)
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(self._path)) from None

    def _put(self, block: Block) -> None:
        if self.error is None:
            try:
                self.write_past_library(block)
            except OSError as error:
                self.error = error
        if self.error is not None:
            self._refused[block.place] = bytes(block.data)

    def _get(self, view: memoryview) -> None:
        view[:] = os.pread(self._descriptor, len(view), self._place).ljust(len(view), b"\0")
        for start, kept in self._refused.items():
            begin, end = max(start, self._place), min(start + len(kept), self._place + len(view))
            if begin < end:
                view[begin - self._place:end - self._place] = kept[begin - start:end - start]

    def _resize(self) -> None:
        if self.error is None:
            try:
                os.ftruncate(self._descriptor, self._size)
            except OSError as error:
                self.error = OSError(error.errno, error.strerror, str(self._path))

    def close(self) -> None:
        """Close the file."""
        if not self.closed:
            os.close(self._descriptor)
        super().close()


class Rows(NamedTuple):
    """Where an array is in a file: row by row, from a place on.

    Attributes
    ----------
    place : int
        Of its first byte.
    shape : tuple of int
        Of the array.
    dtype : numpy.dtype
        Of its values.
    """

    place: int
    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    def place_values(self, first: int, values: NDArray[Any]) -> Block:
        """Place values, (n, ...), in the rows from ``first`` on; raises ValueError where rows have another shape."""
        if values.shape[1:] != self.shape[1:] or first + len(values) > self.shape[0]:
            raise ValueError(f"values of shape {values.shape} from row {first} on, {self.shape} announced")
        n_before = first * int(np.prod(self.shape[1:]))
        return Block(self.place + n_before * self.dtype.itemsize, np.ascontiguousarray(values, self.dtype))


class NewHdf5:
    """An HDF5 file under construction.

    Parameters
    ----------
    file : h5py.File
        To be written as any other.
    stream : _NewFile
        What it is written to.
    """

    def __init__(self, file: h5py.File, stream: _NewFile) -> None:
        self.file = file
        self._stream = stream

    def create_rows(self, name: str, shape: tuple[int, ...], dtype: DTypeLike) -> tuple[h5py.Dataset, Rows]:
        """Create a dataset whose values the library is not told."""
        # In one piece a small mesh takes half the file, and half the time, of one in chunks.
        kept = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        kept.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
        kept.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
        dataset = self.file.create_dataset(name, shape, dtype, dcpl=kept)
        # One without rows has no place.
        return dataset, Rows(dataset.id.get_offset() or 0, shape, dataset.dtype)

    def create_chunk(self, dataset: Any, corner: tuple[int, ...], n_bytes: int) -> int:
        """Make room for a chunk of so many bytes, at least 16, that somebody else writes, and return its place."""
        if n_bytes < len(_RESERVED):
            raise ValueError(f"a chunk of {n_bytes} bytes; at least {len(_RESERVED)}")
        dataset.id.write_direct_chunk(corner, _RESERVED + bytes(n_bytes - len(_RESERVED)))
        return self._stream.reserved

    def write(self, block: Block) -> None:
        """Write a block where room was made; raises OSError where the disk does not take it."""
        self._stream.write_past_library(block)

    def require_written(self) -> None:
        """Raise OSError where the disk has not taken everything so far."""
        self._stream.require_written()

    def get_content(self) -> bytes:
        """Get the bytes of a file in memory, as they would be on a disk."""
        self.file.flush()
        if not isinstance(self._stream, _MemoryFile):
            raise TypeError("the file is on a disk")
        return bytes(self._stream.content)


@contextmanager
def new_hdf5(path: Path | None) -> Iterator[NewHdf5]:
    """Yield an HDF5 file to be written, in memory without a path, which is closed whatever the disk does.

    Raises OSError at the end where the disk has not taken everything. ``path`` is an existing file, which is emptied.
    """
    stream = _MemoryFile() if path is None else _UnfailingFile(path)
    try:
        with stream, h5py.File(stream, "w") as file:
            yield NewHdf5(file, stream)
    except Exception as error:
        if not isinstance(error, OSError):
            # What else went wrong comes of what the disk has refused.
            stream.require_written()
        raise
    stream.require_written()
