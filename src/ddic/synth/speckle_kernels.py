"""Compiled kernels of the speckle texture: drawing speckles cell by cell and summing them at points.

Speckles belong to square cells of CELL_SIZE, numbered over the whole plane. A cell's speckles depend on
the seed and on the cell's number alone, so any part of the plane can be drawn without the rest.
Lengths here are in texture units: pixels divided by the texture's size factor.
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from ddic.arrays import Array, IntArray

# Lengths in texture units; any other number draws another texture from the same seed.
CELL_SIZE = 4.0
# Speckles per unit of area.
DENSITY = 0.08
# Standard deviations of a speckle.
SIGMA_MIN, SIGMA_MAX = 1.3, 1.6
AMPLITUDE_MIN, AMPLITUDE_MAX = 0.5, 1.0
# A speckle ends six standard deviations from its centre, where exp(-18) of its amplitude is left: the sum of
# all tails cut is below 1e-7, that is 3e-3 of a grey level of a 16-bit image.
TAIL_EXPONENT = 18.0
REACH = 6.0 * SIGMA_MAX

_MEAN_COUNT = DENSITY * CELL_SIZE**2
# Points that are summed at once, a whole number of vector registers, and how far they may lie apart: more points share
# the speckles of one neighbourhood, of which fewer reach each.
_GROUP = 16
_GROUP_EXTENT = 16.0
_TO_UNIT = 2.0**-53
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_COLUMN_STRIDE = np.uint64(0xD1B54A32D192ED03)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_SHIFT_30, _SHIFT_27, _SHIFT_31, _SHIFT_11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)


class CellBlock(NamedTuple):
    """A rectangle of cells.

    Attributes
    ----------
    row0, column0 : int
        Its first cell.
    n_rows, n_columns : int
        Its size, cells.
    """

    row0: int
    column0: int
    n_rows: int
    n_columns: int


def _mix_py(z: np.uint64) -> np.uint64:
    """Scramble 64 bits (the finaliser of the splitmix64 generator)."""
    z = (z ^ (z >> _SHIFT_30)) * _MIX_1
    z = (z ^ (z >> _SHIFT_27)) * _MIX_2
    return z ^ (z >> _SHIFT_31)


_mix = numba.njit(cache=True, inline="always")(_mix_py)


def _cell_key_py(seed: np.uint64, row: int, column: int) -> np.uint64:
    """Start of the stream of random numbers of one cell."""
    key: np.uint64 = _mix(_mix(seed + _GOLDEN * np.uint64(row)) + _COLUMN_STRIDE * np.uint64(column))
    return key


_cell_key = numba.njit(cache=True, inline="always")(_cell_key_py)


def _uniform_py(key: np.uint64, index: int) -> float:
    """The number of a cell's stream at ``index``, uniform in [0, 1)."""
    return float(_mix(key + _GOLDEN * np.uint64(index + 1)) >> _SHIFT_11) * _TO_UNIT


_uniform = numba.njit(cache=True, inline="always")(_uniform_py)


def _poisson_py(u: float) -> int:
    """Number of speckles of a cell: the Poisson law of mean _MEAN_COUNT inverted at u in [0, 1)."""
    probability = math.exp(-_MEAN_COUNT)
    cumulated = probability
    count = 0
    while u >= cumulated and probability > 0.0:
        count += 1
        probability *= _MEAN_COUNT / count
        cumulated += probability
    return count


_poisson = numba.njit(cache=True, inline="always")(_poisson_py)


def _count_speckles_py(seed: np.uint64, cells: CellBlock) -> IntArray:
    """First speckle of each cell of a block, row by row, and the total at the end."""
    starts = np.zeros(cells.n_rows * cells.n_columns + 1, dtype=np.int64)
    for row in range(cells.n_rows):
        for column in range(cells.n_columns):
            cell = row * cells.n_columns + column
            key = _cell_key(seed, cells.row0 + row, cells.column0 + column)
            starts[cell + 1] = starts[cell] + _poisson(_uniform(key, 0))
    return starts


count_speckles = numba.njit(cache=True)(_count_speckles_py)


def _draw_speckles_py(seed: np.uint64, cells: CellBlock, starts: IntArray) -> Array:
    """Columns x, y, amplitude and 1 / (2 sigma^2) of the speckles that ``starts`` counts, shape (n, 4)."""
    speckles = np.empty((starts[-1], 4))
    for cell in range(len(starts) - 1):
        row = cells.row0 + cell // cells.n_columns
        column = cells.column0 + cell % cells.n_columns
        key = _cell_key(seed, row, column)
        for s in range(starts[cell], starts[cell + 1]):
            first = 1 + 4 * (s - starts[cell])
            sigma = SIGMA_MIN + (SIGMA_MAX - SIGMA_MIN) * _uniform(key, first + 2)
            speckles[s, 0] = CELL_SIZE * (column + _uniform(key, first))
            speckles[s, 1] = CELL_SIZE * (row + _uniform(key, first + 1))
            speckles[s, 2] = AMPLITUDE_MIN + (AMPLITUDE_MAX - AMPLITUDE_MIN) * _uniform(key, first + 3)
            speckles[s, 3] = 0.5 / sigma**2
    return speckles


draw_speckles = numba.njit(cache=True)(_draw_speckles_py)


def _gaussian_py(t: float) -> float:
    """exp(-t) for 0 <= t <= 18 with an absolute error below 1e-14, in operations that vectorise."""
    z = t * (-1.0 / 64.0)
    e = 1.0 + z * (1.0 / 8.0)
    e = 1.0 + z * (1.0 / 7.0) * e
    e = 1.0 + z * (1.0 / 6.0) * e
    e = 1.0 + z * (1.0 / 5.0) * e
    e = 1.0 + z * (1.0 / 4.0) * e
    e = 1.0 + z * (1.0 / 3.0) * e
    e = 1.0 + z * (1.0 / 2.0) * e
    e = 1.0 + z * e
    e = e * e
    e = e * e
    e = e * e
    e = e * e
    e = e * e
    return e * e


_gaussian = numba.njit(cache=True, inline="always", fastmath={"contract"})(_gaussian_py)


def _group_end_py(x: Array, y: Array, first: int) -> int:
    """End of the run of neighbouring points, at most _GROUP of them, that starts at ``first``."""
    end = first + 1
    while (end < len(x) and end - first < _GROUP
           and abs(x[end] - x[first]) < _GROUP_EXTENT and abs(y[end] - y[first]) < _GROUP_EXTENT):
        end += 1
    return end


_group_end = numba.njit(cache=True)(_group_end_py)


def _add_speckles_py(speckles: Array, px: Array, py: Array, total: Array) -> None:
    """Add speckles (n, 4) to ``total`` at the _GROUP points px, py."""
    for s in range(len(speckles)):
        sx, sy, amplitude, rate = speckles[s, 0], speckles[s, 1], speckles[s, 2], speckles[s, 3]
        for k in range(_GROUP):
            dx, dy = px[k] - sx, py[k] - sy
            t = (dx * dx + dy * dy) * rate
            inside = amplitude if t < TAIL_EXPONENT else 0.0
            total[k] += inside * _gaussian(t if t < TAIL_EXPONENT else TAIL_EXPONENT)


_add_speckles = numba.njit(cache=True, fastmath={"contract"})(_add_speckles_py)


def _sum_speckles_py(x: Array, y: Array, cells: CellBlock, starts: IntArray, speckles: Array) -> Array:
    """Sum of the speckles at points x, y (n,), all at least REACH inside the block of cells."""
    out = np.empty(len(x))
    px, py, total = np.empty(_GROUP), np.empty(_GROUP), np.empty(_GROUP)
    first = 0
    while first < len(x):
        end = _group_end(x, y, first)
        for k in range(_GROUP):
            px[k] = x[min(first + k, end - 1)]
            py[k] = y[min(first + k, end - 1)]
            total[k] = 0.0
        left = math.floor((px.min() - REACH) / CELL_SIZE) - cells.column0
        right = math.floor((px.max() + REACH) / CELL_SIZE) - cells.column0
        top = math.floor((py.min() - REACH) / CELL_SIZE) - cells.row0
        bottom = math.floor((py.max() + REACH) / CELL_SIZE) - cells.row0
        for row in range(top, bottom + 1):
            # The speckles of the cells of a row lie one after the other.
            begin = starts[row * cells.n_columns + left]
            stop = starts[row * cells.n_columns + right + 1]
            _add_speckles(speckles[begin:stop], px, py, total)
        out[first:end] = total[: end - first]
        first = end
    return out


sum_speckles = numba.njit(cache=True)(_sum_speckles_py)
