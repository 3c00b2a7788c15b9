"""HDF5 files opened for reading, where the library does not turn in a loop over a damaged one."""

from __future__ import annotations

import mmap
import struct
from collections.abc import Iterator
from pathlib import Path

import h5py

from ddic.errors import InputError

_Extent = tuple[int, int]
"""First byte and the one behind the last."""

_SIGNATURE = b"GCOL\x01\x00\x00\x00"
"""Of a global heap collection, which holds texts of variable length: HDF5 File Format Specification, section III.E."""

_HEADER, _OBJECT = struct.Struct("<8sQ"), struct.Struct("<HHIQ")
"""Signature and size of a collection; number, references, nothing and size of an object in it."""


def open_hdf5(path: Path) -> h5py.File:
    """Open an HDF5 file for reading.

    The library reads a collection of texts object by object, and stays for ever at one of no size: where a disk has
    left zeros, no time limit in this process ends it. All else that is damaged the library finds by itself. Hence
    collections are looked through here, in what of the file is no array: a few hundred kilobytes of any result.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    h5py.File
        Open; to be closed by the caller.

    Raises
    ------
    InputError
        Where a collection would hold the library for ever, or the objects of the file cannot be listed.
    OSError
        Where it cannot be opened, or is no HDF5 file.
    """
    file = h5py.File(path, "r")
    try:
        _require_finite(path, file)
    except BaseException:
        file.close()
        raise
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
    for start, end in extents:
        if start > at:
            yield at, min(start, size)
        at = max(at, end)
    if at < size:
        yield at, size
