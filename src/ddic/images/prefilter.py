"""Recursive B-spline prefilter of float64 blocks, and slopes of the spline at pixel centres.

A block continues by reflection about its outermost pixels. The recursion runs along columns, so that neighbours in a
row are one vector; rows are turned into columns a few at a time.
"""
# mypy: disable-error-code="no-untyped-def"

import numba
import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array

FLAGS = {"fastmath": {"contract", "reassoc", "nsz", "arcp"}, "error_model": "numpy", "nogil": True, "cache": True}

POLES = {
    # z + 1/z = s; s = -4 of z^2 + 4 z + 1, and the roots of s^2 + 26 s + 64 for z^4 + 26 z^3 + 66 z^2 + 26 z + 1.
    degree: np.array([2.0 / (s - np.sqrt(s * s - 4.0)) for s in sums])
    for degree, sums in {3: [-4.0], 5: [-64.0 / (13.0 + np.sqrt(105.0)), -13.0 - np.sqrt(105.0)]}.items()
}
"""Roots inside the unit circle of the polynomial of the spline's values at integers (1, 4, 1; 1, 26, 66, 26, 1)."""

SLOPE_TAPS = {3: np.array([1.0]) / 2.0, 5: np.array([10.0, 1.0]) / 24.0}
"""Weights of c[k + 1] - c[k - 1], c[k + 2] - c[k - 2] in the slope at pixel k."""

STRIP = 128
"""Columns filtered together: a strip of some 600 rows stays in the second-level cache."""

TURNED = 16
"""Rows that are turned into columns together."""

TERMS = {3: 30, 5: 47}
"""Terms of the first value's series, after which the poles' powers are below 1e-17."""


def prefilter(block: Array, degree: int) -> None:
    """Turn pixels into B-spline coefficients of degree 3 or 5 along both axes, in place."""
    prefilter_rows(block, degree)
    prefilter_columns(block, degree)


def prefilter_columns(block: Array, degree: int) -> None:
    """Turn pixels into coefficients along columns, in place."""
    _filter_columns(block, POLES[degree], TERMS[degree])


def prefilter_rows(block: Array, degree: int) -> None:
    """Turn pixels into coefficients along rows, in place."""
    _filter_rows(block, POLES[degree], TERMS[degree], np.empty((block.shape[1], TURNED)))


def write_row_slopes(block: Array, first: int, degree: int, out: NDArray[np.float32]) -> None:
    """Write the spline's slopes along x at pixel centres, from column ``first`` on, grey levels per pixel.

    Only rows are filtered for that: along columns, values at pixel centres would undo it. The block of grey levels is
    overwritten.
    """
    _row_slopes(block, first, POLES[degree], TERMS[degree], SLOPE_TAPS[degree], out, np.empty((block.shape[1], TURNED)))


def write_column_slopes(coefficients: Array, first: int, degree: int, out: NDArray[np.float32]) -> None:
    """Write slopes along y at pixels from row ``first`` on, grey levels per px, of splines along columns only."""
    _column_slopes(coefficients, first, SLOPE_TAPS[degree], out)


_U = np.uint64


@numba.njit(**FLAGS)
def _reflected(k, n):
    """Where index k of a sequence of n that continues by reflection lies in it."""
    if 0 <= k < n:
        return k
    if n == 1:
        return 0
    k = abs(k) % (2 * n - 2)
    return k if k < n else 2 * n - 2 - k


@numba.njit(**FLAGS)
def _filter_strip(a, begin, end, poles, terms):
    """Filter columns begin to end - 1 of a (n, width), in place: for each pole z, c+ downwards, then c- upwards.

    c+[k] = gain a[k] + z c+[k - 1] and c-[k] = z (c-[k + 1] - c+[k]): M. Unser, A. Aldroubi and M. Eden, IEEE
    Transactions on Signal Processing 41 (1993) 821-833 and 834-848.
    """
    # Rows as sequences and unsigned columns: numba would allow for negative ones, and no loop would be vectorised.
    begin, width, n = _U(begin), _U(end - begin), a.shape[0]
    sums = np.empty(end - begin)
    for z in poles:
        gain = (1.0 - z) * (1.0 - 1.0 / z)
        # c+[0] = gain sum_k z^k a[k], reflected.
        sums[:] = 0.0
        power = gain
        for k in range(terms):
            row = a[_reflected(k, n)]
            for j in range(width):
                sums[j] += power * row[j + begin]
            power *= z
        first = a[0]
        for j in range(width):
            first[j + begin] = sums[j]
        for k in range(1, n):
            row, before = a[k], a[k - 1]
            for j in range(width):
                row[j + begin] = gain * row[j + begin] + z * before[j + begin]
        # Reflection makes c+ known on both sides of the last pixel, which gives c- there.
        last, before = a[n - 1], a[_reflected(n, n)]
        for j in range(width):
            last[j + begin] = z / (z * z - 1.0) * (last[j + begin] + z * before[j + begin])
        for k in range(n - 2, -1, -1):
            row, after = a[k], a[k + 1]
            for j in range(width):
                row[j + begin] = z * (after[j + begin] - row[j + begin])


@numba.njit(**FLAGS)
def _filter_columns(a, poles, terms):
    """Filter all columns of a, strip by strip."""
    for begin in range(0, a.shape[1], STRIP):
        _filter_strip(a, begin, min(begin + STRIP, a.shape[1]), poles, terms)


@numba.njit(**FLAGS)
def _filter_rows(a, poles, terms, turned):
    """Filter the rows of a, some turned into columns at a time."""
    for first in range(0, a.shape[0], TURNED):
        rows = min(TURNED, a.shape[0] - first)
        for k in range(_U(a.shape[1])):
            for i in range(_U(rows)):
                turned[k, i] = a[_U(first) + i, k]
        _filter_strip(turned, 0, rows, poles, terms)
        for i in range(_U(rows)):
            for k in range(_U(a.shape[1])):
                a[_U(first) + i, k] = turned[k, i]


@numba.njit(**FLAGS)
def _row_slopes(a, first, poles, terms, taps, out, turned):
    """Filter the rows of a as ``_filter_rows`` does and write slopes straight from the turned ones."""
    n = a.shape[1]
    for begin in range(0, a.shape[0], TURNED):
        rows = min(TURNED, a.shape[0] - begin)
        for k in range(_U(n)):
            for i in range(_U(rows)):
                turned[k, i] = a[_U(begin) + i, k]
        _filter_strip(turned, 0, rows, poles, terms)
        for k in range(out.shape[1]):
            c, to = first + k, _U(k)
            ahead = turned[_reflected(c + 1, n)]
            behind = turned[_reflected(c - 1, n)]
            if len(taps) == 1:
                for i in range(_U(rows)):
                    out[_U(begin) + i, to] = taps[0] * (ahead[i] - behind[i])
            else:
                far, back = turned[_reflected(c + 2, n)], turned[_reflected(c - 2, n)]
                for i in range(_U(rows)):
                    out[_U(begin) + i, to] = taps[0] * (ahead[i] - behind[i]) + taps[1] * (far[i] - back[i])


@numba.njit(**FLAGS)
def _column_slopes(c, first, taps, out):
    """Write slopes along y of coefficients c (height, width) from row ``first`` on."""
    n = c.shape[0]
    for k in range(out.shape[0]):
        row = out[k]
        ahead = c[_reflected(first + k + 1, n)]
        behind = c[_reflected(first + k - 1, n)]
        if len(taps) == 1:
            for j in range(_U(out.shape[1])):
                row[j] = taps[0] * (ahead[j] - behind[j])
        else:
            far, back = c[_reflected(first + k + 2, n)], c[_reflected(first + k - 2, n)]
            for j in range(_U(out.shape[1])):
                row[j] = taps[0] * (ahead[j] - behind[j]) + taps[1] * (far[j] - back[j])
