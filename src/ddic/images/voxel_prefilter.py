"""Cubic B-spline coefficients of volumes: one symmetric filter along x, y and z, box by box.

The recursive filter whose pole is sqrt(3) - 2 has the impulse response sqrt(3) (sqrt(3) - 2)^|k|, which is cut off
where it is below float32's rounding. Coefficients then depend on the voxels about them alone, not on the box that they
are computed in, and all three passes are the same sum at another stride.
"""
# mypy: disable-error-code="no-untyped-def"

import math

import numba
import numpy as np

from ddic.images.prefilter import FLAGS
from ddic.vectors import WIDTH, fill, load, store

POLE = math.sqrt(3.0) - 2.0

TAPS = 10
"""Voxels on either side that a coefficient is taken from: the next one would add 9e-7 of its grey level."""

_RESPONSE = np.array([math.sqrt(3.0) * POLE**k for k in range(TAPS + 1)])

WEIGHTS = tuple(np.float32(weight) for weight in _RESPONSE / (_RESPONSE[0] + 2.0 * _RESPONSE[1:].sum()))
"""Of the voxel itself and of those 1 to TAPS away; a constant volume keeps its grey level."""

LARGEST_GAIN = 27.0
"""Most that a coefficient may exceed the largest grey level by: three along each axis."""

ROWS = 40
"""Rows that are filtered together: their planes within TAPS of each other stay in the second-level cache."""

INLINED = {**FLAGS, "_nrt": False, "forceinline": True, "cache": False}
"""Of what is called for every row, and kept with what calls it."""


@numba.njit(**INLINED)
def _filter(values, at, step):
    """Filter along the axis whose next voxel is a step away."""
    sum_ = fill(WEIGHTS[0]) * load(values, at)
    for k in range(1, TAPS + 1):
        sum_ = sum_ + fill(WEIGHTS[k]) * (load(values, at + k * step) + load(values, at - k * step))
    return sum_


@numba.njit(**INLINED)
def _filter_row(row, values, offset, to, out):
    """Filter a row of grey levels less an offset along x, from a place on of an array."""
    n = len(values)
    for x in range(0, n - WIDTH + 1, WIDTH):
        store(row, x, load(values, x) - fill(offset))
    for x in range(n // WIDTH * WIDTH, n):
        row[x] = values[x] - offset
    for x in range(0, n - 2 * TAPS, WIDTH):
        store(out, to + x, _filter(row, TAPS + x, 1))


@numba.njit(**INLINED)
def _store_row(values, at, step, scale, last, out):
    """Filter a row of numbers along z, and round what comes of it."""
    width = len(out)
    for x in range(0, width - WIDTH + 1, WIDTH):
        store(out, x, fill(scale) * _filter(values, at + x, step))
    rest = width // WIDTH * WIDTH
    if rest < width:
        store(last, 0, fill(scale) * _filter(values, at + rest, step))
        for k in range(width - rest):
            out[rest + k] = last[k]


@numba.njit(**FLAGS)
def filter_box(values, scale, offset, out):
    """Filter a box of a volume, (n_z + 2 TAPS, n_y + 2 TAPS, n_x + 2 TAPS), into its inner part.

    ``out`` is (n_z, n_y, n_x), int16 or float32, one row after the other: scale times the coefficients of the grey
    levels minus offset.
    """
    n_planes, n_rows, n_columns = values.shape
    height, width = n_rows - 2 * TAPS, n_columns - 2 * TAPS
    wide = (width + WIDTH - 1) // WIDTH * WIDTH + 2 * WIDTH
    row = np.zeros(wide + 2 * TAPS, np.float32)
    along_x = np.empty((ROWS + 2 * TAPS) * wide, np.float32)
    plane = ROWS * wide + 6 * WIDTH
    along_y = np.empty(n_planes * plane, np.float32)
    last = np.empty(WIDTH, out.dtype)
    for top in range(0, height, ROWS):
        n = min(ROWS, height - top)
        for z in range(n_planes):
            for y in range(n + 2 * TAPS):
                _filter_row(row, values[z, top + y], offset, y * wide, along_x)
            for y in range(n):
                for x in range(0, width, WIDTH):
                    store(along_y, z * plane + y * wide + x, _filter(along_x, (TAPS + y) * wide + x, wide))
            if z < 2 * TAPS:
                continue
            for y in range(n):
                _store_row(along_y, (z - TAPS) * plane + y * wide, plane, scale, last, out[z - 2 * TAPS, top + y])
