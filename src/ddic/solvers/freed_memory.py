"""Memory that is freed goes back to the operating system."""

from __future__ import annotations

import ctypes

_TRIM_THRESHOLD, _MMAP_THRESHOLD, _MMAP_MAX = -1, -3, -4
"""Keys of the C library's mallopt."""

_LARGE = 2**22
"""Bytes from which an array is mapped: a larger value keeps more freed memory on the heap."""

_KEPT = 2**26
"""Freed bytes at the heap's end that stay with the process: a smaller value has the system clear the same pages again
for one array after the other, a twentieth of a large run; a larger one keeps more memory."""


def release_freed_memory() -> None:
    """Undo what SuperLU_DIST, which PETSc may be linked with, does to the C library's malloc when it is loaded.

    It forbids mmap and trimming (M_MMAP_MAX = 0), so that a freed factor stays with the process, mostly in pieces
    too small for the next one. Arrays above 4 MiB are mapped again, hence given back when freed; smaller ones stay
    on the heap, where they are fast, the last 64 MiB of it also when freed. Nothing happens where the C library has
    no mallopt (only glibc's has an effect).
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        for option, value in ((_MMAP_MAX, 65536), (_MMAP_THRESHOLD, _LARGE), (_TRIM_THRESHOLD, _KEPT)):
            mallopt(option, value)
