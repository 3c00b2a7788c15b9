"""Compiled kernels of the speckle texture: drawing speckles cell by cell and summing them at points.

Speckles belong to square or cubic cells of CELL_SIZE, numbered over the whole plane or space. A cell's speckles depend
on the seed and on the cell's numbers alone, so any part can be drawn without the rest.
Lengths here are in texture units: pixels divided by the texture's size factor. There are d axes, 2 or 3, in the order
x, y, z.
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from ddic.arrays import Array, IntArray

# Lengths in texture units; any other number draws another texture from the same seed.
CELL_SIZE = 4.0
# Speckles per unit of area, and of volume, by d: the mean of how many lie over one another, each as large as its
# integral over its peak, is 1.06 in both.
DENSITY = {2: 0.08, 3: 0.0219}
# Standard deviations of a speckle.
SIGMA_MIN, SIGMA_MAX = 1.3, 1.6
AMPLITUDE_MIN, AMPLITUDE_MAX = 0.5, 1.0
# A speckle ends six standard deviations from its centre, where exp(-18) of its amplitude is left: the sum of
# all tails cut is below 1e-7, in space 3e-7, that is 3e-3 and 9e-3 of a grey level of a 16-bit image.
TAIL_EXPONENT = 18.0
REACH = 6.0 * SIGMA_MAX

# Mean number of speckles of a square and of a cubic cell.
_MEAN_COUNTS = DENSITY[2] * CELL_SIZE**2, DENSITY[3] * CELL_SIZE**3
# Points that are summed at once, a whole number of vector registers, and how far they may lie apart: more points share
# the speckles of one neighbourhood, of which fewer reach each.
_GROUP = 16
_GROUP_EXTENT = 16.0
_TO_UNIT = 2.0**-53
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
# By axis: a cell's key mixes its numbers in, each times one of these.
_STRIDES = np.uint64(0xD1B54A32D192ED03), _GOLDEN, np.uint64(0x8CB92BA72F3D8DD7)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_SHIFT_30, _SHIFT_27, _SHIFT_31, _SHIFT_11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)


class CellBlock(NamedTuple):
    """A box of cells, which are counted along x, then y, then z.

    Attributes
    ----------
    lower, sizes : tuple of int
        First cell and number of cells along each axis.
    """

    lower: tuple[int, ...]
    sizes: tuple[int, ...]


def _mix_py(z: np.uint64) -> np.uint64:
    """Scramble 64 bits (the finaliser of the splitmix64 generator)."""
    z = (z ^ (z >> _SHIFT_30)) * _MIX_1
    z = (z ^ (z >> _SHIFT_27)) * _MIX_2
    return z ^ (z >> _SHIFT_31)


_mix = numba.njit(cache=True, inline="always")(_mix_py)


def _locate_cell_py(cells: CellBlock, cell: int, place: IntArray) -> None:
    """Write the numbers of a block's cell, along each axis, to ``place`` (d,)."""
    for axis in range(len(place)):
        place[axis] = cells.lower[axis] + cell % cells.sizes[axis]
        cell //= cells.sizes[axis]


_locate_cell = numba.njit(cache=True)(_locate_cell_py)


def _cell_key_py(seed: np.uint64, place: IntArray) -> np.uint64:
    """Start of the stream of random numbers of the cell at ``place`` (d,)."""
    key = seed
    for axis in range(len(place) - 1, -1, -1):
        key = _mix(key + _STRIDES[axis] * np.uint64(place[axis]))
    return key


_cell_key = numba.njit(cache=True)(_cell_key_py)


def _uniform_py(key: np.uint64, index: int) -> float:
    """The number of a cell's stream at ``index``, uniform in [0, 1)."""
    return float(_mix(key + _GOLDEN * np.uint64(index + 1)) >> _SHIFT_11) * _TO_UNIT


_uniform = numba.njit(cache=True, inline="always")(_uniform_py)


def _poisson_py(u: float, mean: float) -> int:
    """Number of speckles of a cell: the Poisson law inverted at u in [0, 1)."""
    probability = math.exp(-mean)
    cumulated = probability
    count = 0
    while u >= cumulated and probability > 0.0:
        count += 1
        probability *= mean / count
        cumulated += probability
    return count


_poisson = numba.njit(cache=True, inline="always")(_poisson_py)


def _count_speckles_py(seed: np.uint64, cells: CellBlock) -> IntArray:
    """First speckle of each cell of a block, and the total at the end."""
    d = len(cells.sizes)
    place, n_cells = np.empty(d, dtype=np.int64), 1
    for axis in range(d):
        n_cells *= cells.sizes[axis]
    starts = np.zeros(n_cells + 1, dtype=np.int64)
    for cell in range(n_cells):
        _locate_cell(cells, cell, place)
        starts[cell + 1] = starts[cell] + _poisson(_uniform(_cell_key(seed, place), 0), _MEAN_COUNTS[d - 2])
    return starts


count_speckles = numba.njit(cache=True)(_count_speckles_py)


def _draw_speckles_py(seed: np.uint64, cells: CellBlock, starts: IntArray) -> Array:
    """Centre, amplitude and 1 / (2 sigma^2) of the speckles that ``starts`` counts, shape (n, d + 2)."""
    d = len(cells.sizes)
    place, speckles = np.empty(d, dtype=np.int64), np.empty((starts[-1], d + 2))
    for cell in range(len(starts) - 1):
        _locate_cell(cells, cell, place)
        key = _cell_key(seed, place)
        for s in range(starts[cell], starts[cell + 1]):
            first = 1 + (d + 2) * (s - starts[cell])
            for axis in range(d):
                speckles[s, axis] = CELL_SIZE * (place[axis] + _uniform(key, first + axis))
            sigma = SIGMA_MIN + (SIGMA_MAX - SIGMA_MIN) * _uniform(key, first + d)
            speckles[s, d] = AMPLITUDE_MIN + (AMPLITUDE_MAX - AMPLITUDE_MIN) * _uniform(key, first + d + 1)
            speckles[s, d + 1] = 0.5 / sigma**2
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


def _group_end_py(coordinates: tuple[Array, ...], first: int) -> int:
    """End of the run of neighbouring points, at most _GROUP of them, that starts at ``first``."""
    end = min(first + _GROUP, len(coordinates[0]))
    for x in coordinates:
        for k in range(first + 1, end):
            if abs(x[k] - x[first]) >= _GROUP_EXTENT:
                end = k
                break
    return end


_group_end = numba.njit(cache=True)(_group_end_py)


def _find_near_py(cells: CellBlock, starts: IntArray, speckles: Array, low: Array, high: Array, near: IntArray) -> int:
    """Write to ``near`` the numbers of the speckles that reach the box from ``low`` to ``high`` (d,); count them."""
    # Known to the compiler, which a number of columns is not.
    d = len(cells.sizes)
    # The plane is one layer of cells.
    begin, last = np.zeros(3, dtype=np.int64), np.zeros(3, dtype=np.int64)
    for axis in range(d):
        begin[axis] = math.floor((low[axis] - REACH) / CELL_SIZE) - cells.lower[axis]
        last[axis] = math.floor((high[axis] + REACH) / CELL_SIZE) - cells.lower[axis]
    n = 0
    for layer in range(begin[2], last[2] + 1):
        for row in range(begin[1], last[1] + 1):
            # The speckles of the cells of a row lie one after the other.
            cell = (layer * cells.sizes[1] + row) * cells.sizes[0]
            for s in range(starts[cell + begin[0]], starts[cell + last[0] + 1]):
                square = 0.0
                for axis in range(d):
                    center = speckles[s, axis]
                    square += max(low[axis] - center, center - high[axis], 0.0) ** 2
                # Without a branch: half of them are near. Of those left out the tail is zero, also with rounding.
                near[n] = s
                n += square * speckles[s, d + 1] < TAIL_EXPONENT + 0.1
    return n


_find_near = numba.njit(cache=True)(_find_near_py)


def _add_speckles_py(d: int, speckles: Array, near: IntArray, at: Array, total: Array) -> None:
    """Add the speckles numbered ``near`` to ``total`` at the _GROUP points ``at`` (d, _GROUP)."""
    x, y, z = at[0], at[1], at[d - 1]
    for s in near:
        sx, sy, sz = speckles[s, 0], speckles[s, 1], speckles[s, d - 1]
        amplitude, rate = speckles[s, d], speckles[s, d + 1]
        for k in range(_GROUP):
            dx, dy, dz = x[k] - sx, y[k] - sy, z[k] - sz
            square = dx * dx + dy * dy
            if d == 3:
                square += dz * dz
            t = square * rate
            inside = amplitude if t < TAIL_EXPONENT else 0.0
            total[k] += inside * _gaussian(t if t < TAIL_EXPONENT else TAIL_EXPONENT)


_add_speckles = numba.njit(cache=True, fastmath={"contract"})(_add_speckles_py)


def _sum_speckles_py(coordinates: tuple[Array, ...], cells: CellBlock, starts: IntArray, speckles: Array) -> Array:
    """Sum of the speckles at points of ``coordinates``, (n,) by axis, all at least REACH inside the block of cells."""
    d, out = len(coordinates), np.empty(len(coordinates[0]))
    at, low, high = np.empty((d, _GROUP)), np.empty(d), np.empty(d)
    total, near = np.empty(_GROUP), np.empty(len(speckles), dtype=np.int64)
    first = 0
    while first < len(out):
        end = _group_end(coordinates, first)
        for axis in range(d):
            for k in range(_GROUP):
                at[axis, k] = coordinates[axis][min(first + k, end - 1)]
            low[axis], high[axis] = at[axis].min(), at[axis].max()
        n = _find_near(cells, starts, speckles, low, high, near)
        total[:] = 0.0
        _add_speckles(d, speckles, near[:n], at, total)
        out[first:end] = total[: end - first]
        first = end
    return out


sum_speckles = numba.njit(cache=True)(_sum_speckles_py)
