"""Freed memory: what is large goes back to the system, what is small is taken again without its help."""

from __future__ import annotations

import resource

import numpy as np

import ddic.solvers.petsc  # noqa: F401  (loads PETSc, and undoes what that does to malloc)

MIB = 2**20


def _write(n_arrays: int, size: int) -> None:
    """Fill some arrays of a size in bytes, all there at once, and free them."""
    arrays = [np.ones(size, np.uint8) for _ in range(n_arrays)]
    del arrays


def _count_faults() -> int:
    """Pages that the system has brought so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt


def _measure_resident() -> int:
    """Bytes of this process in memory."""
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * resource.getpagesize()


def test_small_arrays_are_taken_from_what_others_freed() -> None:
    _write(40, MIB)
    before = _count_faults()
    for _ in range(10):
        _write(40, MIB)
    n_pages = 10 * 40 * MIB // resource.getpagesize()
    assert _count_faults() - before < 0.2 * n_pages


def test_large_arrays_go_back_to_the_system() -> None:
    _write(2, 64 * MIB)
    before = _measure_resident()
    _write(4, 64 * MIB)
    assert _measure_resident() - before < 16 * MIB
