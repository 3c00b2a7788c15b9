"""HDF5 files that may be damaged: opened where the library does not turn in a loop over them."""

import mmap
import struct
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.io.input_file import FileStamps

Arrays = Mapping[str, NDArray[Any]]

READ_ERRORS = (OSError, RuntimeError, KeyError, ValueError, IndexError, TypeError, AttributeError, ArithmeticError,
               MemoryError)
"""What HDF5, h5py and numpy raise on damaged files; h5py passes on most of HDF5's own as RuntimeError."""

MOST_DEFLATED = 1100
"""Bytes that a byte of a compressed dataset can stand for: deflate's limit is 1032."""


def describe_damage(error: BaseException) -> str:
    """Say in a line what could not be read: the first line of the message of one of READ_ERRORS, else its kind."""
    message = str(error.args[0] if isinstance(error, KeyError) and error.args else error).strip()
    return message.splitlines()[0] if message else type(error).__name__


def read_array(dataset: Any, part: Any = ...) -> NDArray[Any]:
    """Read a dataset, whole or a part by its slices, unless it claims to hold more than its file can.

    The file may be damaged. Raises ValueError, with both sizes, where memory would be filled with what is not there.
    """
    # What this program is writing itself, past the library perhaps, is no damaged file.
    if dataset.file.driver != "fileobj":
        stored = min(dataset.id.get_storage_size(), dataset.file.id.get_filesize())
        # Chunks of nothing are not stored: a part is counted alone.
        wanted = np.broadcast_to(np.zeros((), dataset.dtype), dataset.shape)[part].nbytes
        if wanted > stored * (MOST_DEFLATED if dataset.compression else 1):
            raise ValueError(f"{dataset.name} claims {wanted} bytes, of which {stored} are there")
    return np.asarray(dataset[part])


_Extent = tuple[int, int]
"""First byte and the one behind the last."""

_SIGNATURE = b"GCOL\x01\x00\x00\x00"
"""Of a global heap collection, which holds texts of variable length: HDF5 File Format Specification, section III.E."""

_HEADER, _OBJECT = struct.Struct("<8sQ"), struct.Struct("<HHIQ")
"""Signature and size of a collection; number, references, nothing and size of an object in it."""


NONE_KNOWN = FileStamps()


def open_hdf5(path: Path, known: FileStamps = NONE_KNOWN) -> h5py.File:
    """Open an HDF5 file for reading; the caller closes it.

    The library reads a collection of texts object by object, and stays for ever at one of no size: where a disk has
    left zeros, no time limit in this process ends it. All else that is damaged the library finds by itself. Hence
    collections are looked through here, in what of the file is no array: a few hundred kilobytes of any result. Files
    that are ``known`` were looked through before, and are not again as long as they are the same.

    Raises InputError where a collection would hold the library for ever, or the objects of the file cannot be listed;
    OSError where it cannot be opened, or is no HDF5 file.
    """
    with ExitStack() as stack:
        file = stack.enter_context(h5py.File(path, "r"))
        if path not in known.stamps or known.list_changes():
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
        # Without the last byte, in which no collection begins: Python before 3.11.5 looks at the byte behind what it
        # searches, which is no memory where the file fills its pages.
        for begin, end in _find_gaps(_list_arrays(file), len(content) - 1):
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
