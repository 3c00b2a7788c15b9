"""HDF5 files on disks that may be full."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import h5py


class _UnfailingFile(io.RawIOBase):
    """A file that takes every write: what the disk refuses stays in memory, and why is kept.

    The HDF5 library cannot close a file that a disk refuses: it tries again when the process ends, and crashes. Here it
    never sees a failure, closes as it always does, and whoever writes asks for the error afterwards, or in between so
    that little is kept in memory.

    Parameters
    ----------
    path : Path
        An existing file, emptied.

    Attributes
    ----------
    error : OSError or None
        Of the first write that was refused.
    """

    def __init__(self, path: Path) -> None:
        self.error: OSError | None = None
        self._path = path
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o666)
        self._place = 0
        self._size = 0
        self._refused: dict[int, bytes] = {}

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a place.

        Parameters
        ----------
        offset : int
            Bytes.
        whence : int, optional
            From where.

        Returns
        -------
        int
            From the beginning.
        """
        start = {os.SEEK_SET: 0, os.SEEK_CUR: self._place, os.SEEK_END: self._size}[whence]
        self._place = start + offset
        return self._place

    def write(self, data: Any) -> int:
        """Write where the file stands.

        Parameters
        ----------
        data : bytes-like
            All of it is taken.

        Returns
        -------
        int
            Its length.
        """
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
        """Read from where the file stands; zeros where nothing was written.

        Parameters
        ----------
        buffer : bytes-like
            Filled.

        Returns
        -------
        int
            Its length.
        """
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
        """Cut the file, or make it longer.

        Parameters
        ----------
        size : int, optional
            Bytes; by default where the file stands.

        Returns
        -------
        int
            The size.
        """
        self._size = self._place if size is None else size
        if self.error is None:
            try:
                os.ftruncate(self._descriptor, self._size)
            except OSError as error:
                self.error = OSError(error.errno, error.strerror, str(self._path))
        return self._size

    def require_written(self) -> None:
        """Ask whether the disk has taken everything so far.

        Raises
        ------
        OSError
            Where it has not.
        """
        if self.error is not None:
            raise self.error

    def close(self) -> None:
        """Close the file."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
            self._refused = {}
        super().close()


class NewHdf5:
    """An HDF5 file under construction; use it in a ``with`` statement.

    Parameters
    ----------
    path : Path
        An existing file, emptied.
    cache_bytes : int, optional
        For chunks of datasets.

    Attributes
    ----------
    file : h5py.File
        To which datasets are added.
    """

    def __init__(self, path: Path, cache_bytes: int | None = None) -> None:
        self._stream = _UnfailingFile(path)
        self.file = h5py.File(self._stream, "w", rdcc_nbytes=cache_bytes)

    def __enter__(self) -> NewHdf5:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        try:
            self.file.close()
        finally:
            self._stream.close()
        if kind is None or issubclass(kind, Exception):
            # What else went wrong comes of it.
            self.require_written()

    def require_written(self) -> None:
        """Ask whether the disk has taken everything so far.

        Raises
        ------
        OSError
            Where it has not.
        """
        self._stream.require_written()


@contextmanager
def new_hdf5(path: Path) -> Iterator[h5py.File]:
    """Yield an HDF5 file to be written, which is closed whatever the disk does.

    Parameters
    ----------
    path : Path
        An existing file, emptied.

    Yields
    ------
    h5py.File
        To which datasets are added.

    Raises
    ------
    OSError
        Where the disk has not taken everything.
    """
    with NewHdf5(path) as new:
        yield new.file
