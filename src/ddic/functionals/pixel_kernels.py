"""Compiled loops over the pixels of cells, fused with the assembly of cell sums.

``tests/support/readable_kernels.py`` says the same in plain loops, pixel by pixel: read it first, it is the oracle of
this file.

Cells are visited in batches of segments: neighbouring pixels of one row each. Segments of a batch follow each other
without gaps, so that short rows fill vectors as well as long ones, and only what reads images goes row by row: it
writes whole vectors, and the next segment overwrites what is beyond a segment's end. All else is a loop over the
batch's lanes, which the compiler turns into vector instructions without a remainder; lanes after the last segment
repeat its last pixel's position and weigh nothing. Segments whose pixels have one integer offset read spline
coefficients contiguously. Displacements are split into an integer offset and a fraction, so that
no digit is lost to the position in the image. Images are float32, f also uint8 as most files hold it, and everything
computed from them is float64: in float32, Gauss-Newton would not get below 5e-8 px.

What belongs together is one argument, a named tuple: ``Cells``, ``Shapes``, ``ReferencePixels``, ``DeformedPixels``
and ``CellSums`` are what comes from outside, ``_Scratch``, ``Place``, ``_Batch`` and ``_Segment`` what the stages hand
to each other. Their fields cost nothing: the compiler sees single arrays and numbers.

The stages share this file because numba's cache of a kernel does not notice changes in other files.
"""
# mypy: disable-error-code="no-untyped-def, assignment"

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from ddic.arrays import Array, IntArray
from ddic.functionals.instructions import WIDTH, copy_some, copy_vector, count_vector, fill_vector, prefetch
from ddic.images.spline import GradientImage, SplineImage
from ddic.images.window import Window
from ddic.kinematics.cell_interpolation import CellInterpolation
from ddic.mesh.raster import Raster

LANES = 8
"""Numbers in the widest vector."""

LONGEST = 64
"""Most pixels of a segment."""

UNROLLED = 2 * LANES
"""A batch's lanes are a multiple of it, so that no remainder is left where the compiler unrolls as well."""

BATCH = 28 * UNROLLED
"""Most lanes of a batch: what a cell of 15 px uses of the scratch arrays stays in the first-level cache."""

PLANE = BATCH + WIDTH + 8
"""Distance of a batch's quantities in memory: not a power of 2, which would bring all to one set of the cache."""

FLAGS = {"fastmath": {"contract", "reassoc", "nsz", "arcp"}, "error_model": "numpy", "nogil": True, "cache": True}
"""Of all kernels. Sums may be reordered, else no loop that sums would be vectorised; a position that is not a number
stays one."""

STAGE = {**FLAGS, "_nrt": False}
"""Of what is called for every cell. Arrays live as long as the kernel, hence nobody need count who holds them: each
look at a tuple's field would count up and down, atomically, which took half of all time."""

INLINED = {**STAGE, "forceinline": True, "cache": False}
"""The same, where a call costs: without it, code loaded from the cache was slower than just compiled. It is kept with
the kernels that call it: a cache of its own would open two files at every start."""

N_SUMS = 6
"""Sums over usable pixels of (1, r, g, r^2, g^2, r g) with r = f - g(x + u)."""

LINE = 16
"""Pixels in a line of the cache."""

FROM_START = np.int64(-(2**31))
"""Column before any run's first one."""

AHEAD = 2
"""Cells between the one that is worked on and the one whose pixels are fetched."""

DISTORTED = 0.3
"""Least det J of a cell, relative to its centre, at which one Newton step from float32 gives xi and eta to 1e-12."""

AFFINE = 1e-11
"""A cell whose xi eta term is below this, relative to its linear terms, is a parallelogram but for rounding."""


class Cells(NamedTuple):
    """Cells of a mesh and the pixels of each.

    Attributes
    ----------
    order : (n_visited,) int64 array
        Cells in the order of visiting: where neighbours follow each other, they find their pixels in the cache.
    geometry : (n_cells, 2, 4) float64 array
        Coefficients of (x, y) on the monomials (1, xi, eta, xi eta), pixels.
    first_row : (n_cells,) int64 array
        Row of each cell's first run of pixels.
    row_ptr : (n_cells + 1,) int64 array
        Cell e owns the runs row_ptr[e] : row_ptr[e + 1], one a row.
    starts, stops : (n_runs,) int32 arrays
        Half-open columns of each run, which may be empty.
    """

    order: IntArray
    geometry: Array
    first_row: IntArray
    row_ptr: IntArray
    starts: NDArray[np.int32]
    stops: NDArray[np.int32]


class Shapes(NamedTuple):
    """Shape functions of cells.

    Attributes
    ----------
    coefficients : (n_kinds, 4, 4) float64 array
        N_a on the monomials (1, xi, eta, xi eta), for each kind of cell; a T3's fourth row is zero.
    kinds : (n_cells,) int64 array
        Each cell's place in ``coefficients``.
    """

    coefficients: Array
    kinds: IntArray


class ReferencePixels(NamedTuple):
    """A window of the reference image f with its gradient at pixel centres.

    Attributes
    ----------
    values : (n,) float32 or uint8 array
    by_x, by_y : (n,) float32 arrays
        f and grad f, grey levels and grey levels per pixel: rows, one after the other.
    row_length : int
        Numbers from one row to the next.
    x0, y0 : int
        The window's first pixel.
    usable : (height, width) uint8 array
        0 where a pixel is excluded; (0, 0) where none is, so that there is one compiled kernel for both.
    """

    values: NDArray[np.float32 | np.uint8]
    by_x: NDArray[np.float32]
    by_y: NDArray[np.float32]
    row_length: int
    x0: int
    y0: int
    usable: NDArray[np.uint8]


class DeformedPixels(NamedTuple):
    """A window of the deformed image g as spline coefficients.

    Attributes
    ----------
    coefficients : (n,) float32 array
        Rows, one after the other; the window's first pixel's one has (degree + 1) / 2 rows above it, likewise columns.
    row_length : int
        Numbers from one row to the next.
    degree : int
        Of the spline, 3 or 5.
    x0, y0 : int
        The window's first pixel.
    usable : (height, width) uint8 array
        0 where g between the pixel and its lower right neighbour is interpolated from an excluded one; (0, 0) where
        nothing is excluded.
    image_width, image_height : int
        Size of the whole image, pixels.
    """

    coefficients: NDArray[np.float32]
    row_length: int
    degree: int
    x0: int
    y0: int
    usable: NDArray[np.uint8]
    image_width: int
    image_height: int


class CellSums(NamedTuple):
    """What ``residual_sums`` adds to.

    Attributes
    ----------
    moments : (n_cells, 1 or 3, 2, 4) float64 array
        Sums of (r, g, 1) x (f_x, f_y) x (1, xi, eta, xi eta), r = f - g(x + u).
    grey : (n_cells, 6) float64 array
        Sums of (1, r, g, r^2, g^2, r g).
    """

    moments: Array
    grey: Array


class _Scratch(NamedTuple):
    """Buffers for the pixels of a batch; several quantities in each, PLANE numbers apart.

    One array for many, because the compiler then knows them apart, and because it has too few registers for the
    addresses of many: quantities by lane at the places _XI to _G, what is read or counted at _COLUMN to _BY_Y, integer
    parts of displacements at _WHOLE_X and _WHOLE_Y, segments at _SEGMENT_X to _SEGMENT_LANE, and runs at _RUN_AT to
    _RUN_END.
    """

    lanes: Array
    pixels: NDArray[np.float32]
    offsets: NDArray[np.int32]
    bounds: IntArray


class Place(NamedTuple):
    """Where in a cell's runs of pixels the next batch begins.

    Attributes
    ----------
    run, last_run : uint64
        The run, and the one after the cell's last.
    x, y : int64
        The pixel; a column before the run's first one stands for it.
    """

    run: Any
    last_run: Any
    x: Any
    y: Any


class _Batch(NamedTuple):
    """Pixels of one cell that are worked on together; _COLUMN and _ROW are counted from (x0, y0).

    Segments are rows, or parts of rows; lanes are pixels, rounded up to a multiple of UNROLLED. Lanes and cell are
    uint64, the others int64.
    """

    cell: Any
    x0: Any
    y0: Any
    n_segments: Any
    n_lanes: Any


class _Segment(NamedTuple):
    """Neighbouring pixels of one row, int64: column and row of the first one, how many, and its lane in the batch."""

    x: Any
    y: Any
    length: Any
    lane: Any


class _Demand(NamedTuple):
    """Rows of pixels of a later cell that are still to be asked for: the run of the next row, and that after the last.

    These are uint64; the others, int64, are where the pixel of column 0 of that row would lie in the reference image's
    arrays, and the last tap's row of its coefficients in the deformed image's.
    """

    run: Any
    last_run: Any
    in_reference: Any
    in_deformed: Any


# Unsigned, so that numba need not allow for negative indices: that keeps loops from being vectorised, and outside
# them costs as much as the arithmetic on a pixel.
_U = np.uint64
_0, _1 = _U(0), _U(1)

_XI, _ETA, _FRACTION_X, _FRACTION_Y, _WEIGHT, _G = (_U(k * PLANE) for k in range(6))
"""In ``lanes``: local coordinates, fractions of the displacement, 1 or 0 for a pixel that counts or not, g(x + u)."""

_COLUMN, _ROW, _F, _BY_X, _BY_Y = (_U(k * PLANE) for k in range(5))
"""In ``pixels``: columns and rows from the batch's first pixel, f and grad f."""

_WHOLE_X, _WHOLE_Y = (_U(k * PLANE) for k in range(2))
"""In ``offsets``: integer parts of the displacement."""

_SEGMENT_X, _SEGMENT_Y, _SEGMENT_LENGTH, _SEGMENT_LANE = (_U(k * PLANE) for k in range(4))
"""In ``bounds``: fields of ``_Segment``; one more first lane, after the last segment, ends the last one."""

_RUN_AT, _RUN_BEGIN, _RUN_END = (_U(k * PLANE) for k in range(4, 7))
"""In ``bounds``, runs of lanes with one integer offset: first coefficient, first lane and the lane after the last."""


@numba.njit(**INLINED)
def _padded(n):
    """n, rounded up to a multiple of LANES."""
    return _U((n + (LANES - 1)) & -LANES)


@numba.njit(**INLINED)
def _segment(scratch, s):
    """Segment s of the batch."""
    s = _U(s)
    bounds = scratch.bounds
    return _Segment(bounds[s + _SEGMENT_X], bounds[s + _SEGMENT_Y], bounds[s + _SEGMENT_LENGTH],
                    bounds[s + _SEGMENT_LANE])


@numba.njit(**INLINED)
def _begin_cell(cells, e):
    """Where the pixels of cell e begin."""
    return Place(_U(cells.row_ptr[e]), _U(cells.row_ptr[e + _1]), FROM_START, cells.first_row[e])


@numba.njit(**INLINED)
def _write_segment(reference, x, y, batch_x, batch_y, lane, length, pixels):
    """Write a segment's positions, f and grad f in whole vectors: what is beyond its end, the next one overwrites."""
    column, row = np.float32(x - batch_x), np.float32(y - batch_y)
    last = reference.values.size - WIDTH
    i = (y - reference.y0) * reference.row_length + x - reference.x0
    j, end = lane, lane + length
    while j < end:
        to = _U(j)
        count_vector(pixels, to + _COLUMN, column)
        fill_vector(pixels, to + _ROW, row)
        if i <= last:
            copy_vector(pixels, to + _F, reference.values, i)
            copy_vector(pixels, to + _BY_X, reference.by_x, i)
            copy_vector(pixels, to + _BY_Y, reference.by_y, i)
        else:
            copy_some(pixels, to + _F, reference.values, i, end - j)
            copy_some(pixels, to + _BY_X, reference.by_x, i, end - j)
            copy_some(pixels, to + _BY_Y, reference.by_y, i, end - j)
        i += WIDTH
        j += WIDTH
        column += np.float32(WIDTH)


@numba.njit(**INLINED)
def _take_batch(cells, reference, e, place, scratch):
    """Fill a batch with the pixels of cell e from a place on; returns the batch and where to go on."""
    pixels, bounds = scratch.pixels, scratch.bounds
    run, x, y = place.run, place.x, place.y
    # Positions are counted from the cell's first pixel.
    x0, y0 = np.int64(cells.starts[_U(cells.row_ptr[e])]), cells.first_row[e]
    n, lane = _0, 0
    while run < place.last_run and lane < BATCH:
        x = max(x, np.int64(cells.starts[run]))
        length = min(cells.stops[run] - x, LONGEST, BATCH - lane)
        if length > 0:
            bounds[n + _SEGMENT_X], bounds[n + _SEGMENT_Y] = x, y
            bounds[n + _SEGMENT_LENGTH], bounds[n + _SEGMENT_LANE] = length, lane
            _write_segment(reference, x, y, x0, y0, lane, length, pixels)
            x += length
            lane += length
            n += _1
        if x >= cells.stops[run]:
            run += _1
            y += 1
            x = FROM_START
    bounds[n + _SEGMENT_LANE] = lane
    end, n_lanes = _U(lane), _U((lane + UNROLLED - 1) // UNROLLED * UNROLLED)
    if lane > 0:
        column, row = pixels[end - _1 + _COLUMN], pixels[end - _1 + _ROW]
        for k in range(n_lanes - end):
            pixels[k + end + _COLUMN] = column
            pixels[k + end + _ROW] = row
    return _Batch(e, x0, y0, np.int64(n), n_lanes), Place(run, place.last_run, x, y)


@numba.njit(**INLINED)
def _find_local_coordinates(geometry, batch, scratch):
    """Invert x = X phi(xi, eta) at the batch's lanes: linear in a parallelogram, else two quadratics.

    With x - X_0 = e xi + f eta + g xi eta and vectors divided by e x f, xi = x x f and eta = e x x where g = 0.
    """
    X, e, lanes, pixels = geometry, batch.cell, scratch.lanes, scratch.pixels
    x0, y0 = batch.x0 - X[e, 0, 0], batch.y0 - X[e, 1, 0]
    ef = X[e, 0, 1] * X[e, 1, 2] - X[e, 1, 1] * X[e, 0, 2]
    e0, e1, f0, f1 = X[e, 0, 1] / ef, X[e, 1, 1] / ef, X[e, 0, 2] / ef, X[e, 1, 2] / ef
    g0, g1 = X[e, 0, 3] / ef, X[e, 1, 3] / ef
    if abs(g0) + abs(g1) <= AFFINE * (abs(e0) + abs(e1) + abs(f0) + abs(f1)):
        for k in range(batch.n_lanes):
            x, y = x0 + pixels[k + _COLUMN], y0 + pixels[k + _ROW]
            lanes[k + _XI] = f1 * x - f0 * y
            lanes[k + _ETA] = e0 * y - e1 * x
        return
    # Of the quadratics a t^2 + b t + c = 0 for eta and for xi, whose slopes at the solution are s and -s.
    a_eta, a_xi = (g0 * f1 - g1 * f0) * ef, (g0 * e1 - g1 * e0) * ef
    if 1.0 - abs(a_eta) - abs(a_xi) < DISTORTED:
        for k in range(batch.n_lanes):
            x, y = x0 + pixels[k + _COLUMN], y0 + pixels[k + _ROW]
            hg, c_eta, c_xi = x * g1 - y * g0, x * e1 - y * e0, x * f1 - y * f0
            s = np.sqrt(max((1.0 + hg) * (1.0 + hg) - 4.0 * a_eta * c_eta, 0.0))
            lanes[k + _XI], lanes[k + _ETA] = 2.0 * c_xi / (1.0 - hg + s), -2.0 * c_eta / (1.0 + hg + s)
        return
    # A root and a reciprocal in float32, and a step of Newton's, spare a root and two divisions in float64.
    a4 = np.float32(4.0 * a_eta)
    for k in range(batch.n_lanes):
        x, y = x0 + pixels[k + _COLUMN], y0 + pixels[k + _ROW]
        hg = x * g1 - y * g0
        c_eta, c_xi = x * e1 - y * e0, x * f1 - y * f0
        b_eta, b_xi = hg + 1.0, hg - 1.0
        b, c, d = np.float32(b_eta), np.float32(c_eta), np.float32(c_xi)
        s = np.sqrt(b * b - a4 * c)
        p, q = b + s, s - np.float32(b_xi)
        pq = p * q
        r = np.float32(1.0) / (pq * s)
        sr = s * r
        sr += sr
        slope = np.float64(pq * r)
        t, u = np.float64(-(c * q) * sr), np.float64((d * p) * sr)
        t -= (c_eta + t * (b_eta + a_eta * t)) * slope
        u += (c_xi + u * (b_xi + a_xi * u)) * slope
        lanes[k + _XI], lanes[k + _ETA] = u, t


@numba.njit(**INLINED)
def _displace(displacement, batch, scratch):
    """Split u = D phi of the lanes into integer offsets and fractions; returns the least and largest offsets."""
    D, e, lanes, offsets = displacement, batch.cell, scratch.lanes, scratch.offsets
    u0, u1, u2, u3 = D[e, 0, 0], D[e, 0, 1], D[e, 0, 2], D[e, 0, 3]
    v0, v1, v2, v3 = D[e, 1, 0], D[e, 1, 1], D[e, 1, 2], D[e, 1, 3]
    least_x, least_y, most_x, most_y = np.int32(2**31 - 1), np.int32(2**31 - 1), np.int32(-(2**31)), np.int32(-(2**31))
    for k in range(batch.n_lanes):
        t, s = lanes[k + _XI], lanes[k + _ETA]
        p = t * s
        u = u0 + u1 * t + u2 * s + u3 * p
        v = v0 + v1 * t + v2 * s + v3 * p
        fu, fv = np.floor(u), np.floor(v)
        lanes[k + _FRACTION_X], lanes[k + _FRACTION_Y] = u - fu, v - fv
        i, j = np.int32(fu), np.int32(fv)
        offsets[k + _WHOLE_X], offsets[k + _WHOLE_Y] = i, j
        least_x, least_y = min(least_x, i), min(least_y, j)
        most_x, most_y = max(most_x, i), max(most_y, j)
    return least_x, least_y, most_x, most_y


@numba.njit(**STAGE)
def _keep_inside(displacement, e, segment, deformed, scratch):
    """Give the lanes of a segment whose x + u leaves the image the nearest position in it and no weight."""
    D, lanes, offsets = displacement, scratch.lanes, scratch.offsets
    width, height = deformed.image_width, deformed.image_height
    for k in range(segment.length):
        j = _U(segment.lane + k)
        t, s = lanes[j + _XI], lanes[j + _ETA]
        x, y = segment.x + k, segment.y
        px = x + (D[e, 0, 0] + D[e, 0, 1] * t + D[e, 0, 2] * s + D[e, 0, 3] * (t * s))
        py = y + (D[e, 1, 0] + D[e, 1, 1] * t + D[e, 1, 2] * s + D[e, 1, 3] * (t * s))
        if not (0.0 <= px <= width - 1.0 and 0.0 <= py <= height - 1.0):
            lanes[j + _WEIGHT] = 0.0
            # Written so that a position that is not a number becomes 0.
            px = px if px > 0.0 else 0.0
            py = py if py > 0.0 else 0.0
            px, py = min(px, width - 1.0), min(py, height - 1.0)
            fx, fy = np.floor(px), np.floor(py)
            offsets[j + _WHOLE_X], offsets[j + _WHOLE_Y] = np.int32(fx) - x, np.int32(fy) - y
            lanes[j + _FRACTION_X], lanes[j + _FRACTION_Y] = px - fx, py - fy


@numba.njit(**INLINED)
def _cubic_weights(t):
    """Weights of the four coefficients about a fraction t of a pixel."""
    u = 1.0 - t
    w0, w3 = u * u * u * (1 / 6), t * t * t * (1 / 6)
    w1 = (2 / 3) - 0.5 * t * t * (1.0 + u)
    # The last weight is what the others leave to 1, so that constants are kept to rounding.
    return w0, w1, 1.0 - w0 - w1 - w3, w3


@numba.njit(**INLINED)
def _evaluate_cubic(deformed, run, scratch):
    """Evaluate the cubic spline at the lanes of a run."""
    c, lanes, bounds = deformed.coefficients, scratch.lanes, scratch.bounds
    d1, d2, d3 = _U(deformed.row_length), _U(2 * deformed.row_length), _U(3 * deformed.row_length)
    first, begin, end = _U(bounds[run + _RUN_AT]), _U(bounds[run + _RUN_BEGIN]), _U(bounds[run + _RUN_END])
    for k in range(end - begin):
        x0, x1, x2, x3 = _cubic_weights(lanes[k + begin + _FRACTION_X])
        y0, y1, y2, y3 = _cubic_weights(lanes[k + begin + _FRACTION_Y])
        i = first + k
        a0 = y0 * c[i] + y1 * c[i + d1] + y2 * c[i + d2] + y3 * c[i + d3]
        i += _U(1)
        a1 = y0 * c[i] + y1 * c[i + d1] + y2 * c[i + d2] + y3 * c[i + d3]
        i += _U(1)
        a2 = y0 * c[i] + y1 * c[i + d1] + y2 * c[i + d2] + y3 * c[i + d3]
        i += _U(1)
        a3 = y0 * c[i] + y1 * c[i + d1] + y2 * c[i + d2] + y3 * c[i + d3]
        lanes[k + begin + _G] = x0 * a0 + x1 * a1 + x2 * a2 + x3 * a3


@numba.njit(**STAGE)
def _quintic_weights(t):
    """Weights of the six coefficients about a fraction t of a pixel."""
    u = 1.0 - t
    t2, u2 = t * t, u * u
    w0, w5 = u2 * u2 * u * (1 / 120), t2 * t2 * t * (1 / 120)
    w1 = (26 / 120) + t * ((-50 / 120) + t * ((20 / 120) + t * (
        (20 / 120) + t * ((-20 / 120) + (5 / 120) * t))))
    w4 = (26 / 120) + u * ((-50 / 120) + u * ((20 / 120) + u * (
        (20 / 120) + u * ((-20 / 120) + (5 / 120) * u))))
    w2 = (66 / 120) + t2 * ((-60 / 120) + t2 * ((30 / 120) - (10 / 120) * t))
    return w0, w1, w2, 1.0 - w0 - w1 - w2 - w4 - w5, w4, w5


@numba.njit(**STAGE)
def _evaluate_quintic(deformed, run, scratch):
    """Evaluate the quintic spline at the lanes of a run."""
    c, lanes, bounds = deformed.coefficients, scratch.lanes, scratch.bounds
    d = _U(deformed.row_length)
    first, begin, end = _U(bounds[run + _RUN_AT]), _U(bounds[run + _RUN_BEGIN]), _U(bounds[run + _RUN_END])
    for k in range(end - begin):
        x0, x1, x2, x3, x4, x5 = _quintic_weights(lanes[k + begin + _FRACTION_X])
        y0, y1, y2, y3, y4, y5 = _quintic_weights(lanes[k + begin + _FRACTION_Y])
        i0 = first + k
        i1 = i0 + d
        i2 = i1 + d
        i3 = i2 + d
        i4 = i3 + d
        i5 = i4 + d
        value = 0.0
        for j, x in enumerate((x0, x1, x2, x3, x4, x5)):
            o = _U(j)
            value += x * (y0 * c[i0 + o] + y1 * c[i1 + o] + y2 * c[i2 + o]
                          + y3 * c[i3 + o] + y4 * c[i4 + o] + y5 * c[i5 + o])
        lanes[k + begin + _G] = value


@numba.njit(**INLINED)
def _find_runs(uniform, deformed, batch, scratch):
    """Split segments into runs of one integer offset; returns the number of runs.

    uniform: all lanes have one offset. A run that is a whole segment is padded as the segment is, if the coefficients
    go on so far.
    """
    bounds, offsets = scratch.bounds, scratch.offsets
    size, stride = deformed.coefficients.size, deformed.row_length
    span = deformed.degree * (stride + 1)
    # Taps of a pixel's first coefficient lie degree // 2 pixels before it, and the array begins one more before.
    down, right = 1 - deformed.y0, 1 - deformed.x0
    if uniform:
        first = (offsets[_WHOLE_Y] + down) * stride + offsets[_WHOLE_X] + right
        for s in range(_U(batch.n_segments)):
            x, y, n, j = _segment(scratch, s)
            at = y * stride + x + first
            padded = np.int64(_padded(n))
            bounds[s + _RUN_AT], bounds[s + _RUN_BEGIN] = at, j
            bounds[s + _RUN_END] = j + (padded if at + span + padded <= size else n)
        return batch.n_segments
    n_runs = _0
    for s in range(batch.n_segments):
        x, y, n, j = _segment(scratch, s)
        differ = np.int32(0)
        for k in range(_U(n)):
            differ |= ((offsets[k + _U(j) + _WHOLE_X] ^ offsets[_U(j) + _WHOLE_X])
                       | (offsets[k + _U(j) + _WHOLE_Y] ^ offsets[_U(j) + _WHOLE_Y]))
        begin = np.int64(0)
        while begin < n:
            i, end = _U(j + begin), n
            ox, oy = offsets[i + _WHOLE_X], offsets[i + _WHOLE_Y]
            if differ != 0:
                end = begin + 1
                while end < n and offsets[_U(j + end) + _WHOLE_X] == ox and offsets[_U(j + end) + _WHOLE_Y] == oy:
                    end += 1
            at = (y + oy + down) * stride + x + begin + ox + right
            padded = np.int64(_padded(end - begin))
            bounds[n_runs + _RUN_AT], bounds[n_runs + _RUN_BEGIN] = at, j + begin
            bounds[n_runs + _RUN_END] = j + begin + padded if at + span + padded <= size else j + end
            n_runs += _1
            begin = end
    return np.int64(n_runs)


@numba.njit(**INLINED)
def _weigh(reference, batch, scratch):
    """Weight 1 for those lanes that are pixels which f does not exclude, else 0."""
    lanes, usable = scratch.lanes, reference.usable
    end = np.int32(scratch.bounds[_U(batch.n_segments) + _SEGMENT_LANE])
    for k in range(batch.n_lanes):
        lanes[k + _WEIGHT] = 1.0 if np.int32(k) < end else 0.0
    if usable.size > 0:
        for s in range(batch.n_segments):
            segment = _segment(scratch, s)
            row, column = segment.y - reference.y0, segment.x - reference.x0
            for k in range(segment.length):
                lanes[_U(segment.lane + k) + _WEIGHT] *= usable[row, column + k]


@numba.njit(**INLINED)
def _weigh_deformed(deformed, batch, scratch):
    """Weight 0 for lanes whose x + u lies beside a pixel that g excludes."""
    lanes, offsets = scratch.lanes, scratch.offsets
    for s in range(batch.n_segments):
        segment = _segment(scratch, s)
        row, column = segment.y - deformed.y0, segment.x - deformed.x0
        for k in range(segment.length):
            j = _U(segment.lane + k)
            lanes[j + _WEIGHT] *= deformed.usable[row + offsets[j + _WHOLE_Y], column + k + offsets[j + _WHOLE_X]]


@numba.njit(**INLINED)
def _demand(cells, displacement, reference, deformed, visit):
    """Rows of the cell that is visited AHEAD of another one, none where there is none."""
    if visit + AHEAD >= len(cells.order):
        return _Demand(_0, _0, np.int64(0), np.int64(0))
    e = _U(cells.order[visit + AHEAD])
    # The cell's centre stands for its pixels, and the rows above the last tap's were asked for by the cell above it.
    right = np.int64(np.floor(displacement[e, 0, 0])) + 1
    down = np.int64(np.floor(displacement[e, 1, 0])) + deformed.degree + 1
    y = cells.first_row[e]
    return _Demand(_U(cells.row_ptr[e]), _U(cells.row_ptr[e + _1]),
                   (y - reference.y0) * reference.row_length - reference.x0,
                   (y + down - deformed.y0) * deformed.row_length + right - deformed.x0)


@numba.njit(**INLINED)
def _fetch_row(cells, reference, deformed, demand):
    """Ask for the next row and for the line after it, where the next cell is likely to begin; returns what is left.

    A row at a time, between others' work: many requests at once would have to wait for each other.
    """
    run, last_run, in_reference, in_deformed = demand
    if run >= last_run:
        return demand
    x, stop = np.int64(cells.starts[run]), np.int64(cells.stops[run]) + (2 * LINE - 1)
    while x < stop:
        prefetch(reference.values, in_reference + x)
        prefetch(reference.by_x, in_reference + x)
        prefetch(reference.by_y, in_reference + x)
        prefetch(deformed.coefficients, in_deformed + x)
        x += LINE
    return _Demand(run + _1, last_run, in_reference + reference.row_length, in_deformed + deformed.row_length)


@numba.njit(**INLINED)
def _evaluate_deformed(cells, displacement, reference, deformed, batch, demand, scratch):
    """Evaluate g at x + u(x) and the weights of a batch: 0 where x + u leaves the image, or f or g excludes it.

    Asks for a row of the later cell with each of its own; returns what is left to ask for.
    """
    _find_local_coordinates(cells.geometry, batch, scratch)
    _weigh(reference, batch, scratch)
    least_x, least_y, most_x, most_y = _displace(displacement, batch, scratch)
    left, right = np.int64(2**40), np.int64(-(2**40))
    # Rows go from top to bottom, so that the last segment's is the lowest.
    top, bottom = scratch.bounds[_SEGMENT_Y], np.int64(0)
    for s in range(batch.n_segments):
        segment = _segment(scratch, s)
        left, right, bottom = min(left, segment.x), max(right, segment.x + segment.length), segment.y
    uniform = least_x == most_x and least_y == most_y
    if (left + least_x < 0 or right + most_x >= deformed.image_width
            or top + least_y < 0 or bottom + most_y + 1 >= deformed.image_height):
        uniform = False
        for s in range(batch.n_segments):
            _keep_inside(displacement, batch.cell, _segment(scratch, s), deformed, scratch)
    n_runs = _find_runs(uniform, deformed, batch, scratch)
    for run in range(_U(n_runs)):
        demand = _fetch_row(cells, reference, deformed, demand)
        if deformed.degree == 3:
            _evaluate_cubic(deformed, run, scratch)
        else:
            _evaluate_quintic(deformed, run, scratch)
    if deformed.usable.size > 0:
        _weigh_deformed(deformed, batch, scratch)
    return demand


@numba.njit(**INLINED)
def _add_residual_sums(batch, scratch, sums):
    """Add the lanes' sums of r grad f times the monomials to the cell's first moments, and their grey sums."""
    e, lanes, pixels = batch.cell, scratch.lanes, scratch.pixels
    m00 = m01 = m02 = m03 = m10 = m11 = m12 = m13 = 0.0
    s0 = s1 = s2 = s3 = s4 = s5 = 0.0
    for k in range(batch.n_lanes):
        t, s, w = lanes[k + _XI], lanes[k + _ETA], lanes[k + _WEIGHT]
        g = w * lanes[k + _G]
        r = w * pixels[k + _F] - g
        s0 += w
        s1 += r
        s2 += g
        s3 += r * r
        s4 += g * g
        s5 += r * g
        a, b = r * pixels[k + _BY_X], r * pixels[k + _BY_Y]
        at, bt = a * t, b * t
        m00 += a
        m01 += at
        m02 += a * s
        m03 += at * s
        m10 += b
        m11 += bt
        m12 += b * s
        m13 += bt * s
    for k, value in enumerate((s0, s1, s2, s3, s4, s5)):
        sums.grey[e, k] += value
    for k, value in enumerate((m00, m01, m02, m03)):
        sums.moments[e, 0, 0, k] += value
    for k, value in enumerate((m10, m11, m12, m13)):
        sums.moments[e, 0, 1, k] += value


@numba.njit(**STAGE)
def _add_moments(kind, batch, scratch, sums):
    """Add the lanes' sums of g (kind 1) or 1 (2) times grad f and the monomials to the cell's moments of that kind."""
    e, lanes, pixels = batch.cell, scratch.lanes, scratch.pixels
    m00 = m01 = m02 = m03 = m10 = m11 = m12 = m13 = 0.0
    for k in range(batch.n_lanes):
        t, s, w = lanes[k + _XI], lanes[k + _ETA], lanes[k + _WEIGHT]
        value = w * lanes[k + _G] if kind == 1 else w
        a, b = value * pixels[k + _BY_X], value * pixels[k + _BY_Y]
        at, bt = a * t, b * t
        m00 += a
        m01 += at
        m02 += a * s
        m03 += at * s
        m10 += b
        m11 += bt
        m12 += b * s
        m13 += bt * s
    for k, value in enumerate((m00, m01, m02, m03)):
        sums.moments[e, kind, 0, k] += value
    for k, value in enumerate((m10, m11, m12, m13)):
        sums.moments[e, kind, 1, k] += value


@numba.njit(**FLAGS)
def _aligned(array):
    """The array from the first number on that begins a line of the cache: a vector across two lines takes two loads."""
    ahead = -np.int64(array.ctypes.data) & (4 * LINE - 1)
    return array[ahead // array.itemsize:]


@numba.njit(**FLAGS)
def _new_scratch():
    """Buffers of a batch: zeros, since a lane that is no pixel must be a number for its product with 0 to be 0."""
    return _Scratch(_aligned(np.zeros(7 * PLANE)), _aligned(np.zeros(6 * PLANE, np.float32)),
                    _aligned(np.zeros(3 * PLANE, np.int32)), _aligned(np.zeros(8 * PLANE, np.int64)))


@numba.njit(**INLINED)
def _fetch_rows(array, row_length, x0, y0, cells, e):
    """Ask for the pixels of cell e in a flat array of rows that begins with pixel (x0, y0).

    And for the line after each row, where the next cell is likely to begin.
    """
    begin = (cells.first_row[e] - y0) * row_length - x0
    for run in range(_U(cells.row_ptr[e]), _U(cells.row_ptr[e + _1])):
        x, stop = begin + cells.starts[run], begin + cells.stops[run] + 2 * LINE - 1
        while x < stop:
            prefetch(array, x)
            x += LINE
        begin += row_length


@numba.njit(**INLINED)
def _fetch_reference(reference, cells, e):
    """The same of the reference image and its slopes, in one loop."""
    begin = (cells.first_row[e] - reference.y0) * reference.row_length - reference.x0
    for run in range(_U(cells.row_ptr[e]), _U(cells.row_ptr[e + _1])):
        x, stop = begin + cells.starts[run], begin + cells.stops[run] + 2 * LINE - 1
        while x < stop:
            prefetch(reference.values, x)
            prefetch(reference.by_x, x)
            prefetch(reference.by_y, x)
            x += LINE
        begin += reference.row_length


@numba.njit(**INLINED)
def _fetch_numbers(array, e, n):
    """Ask for the n float64 numbers of cell e in a flat array: cells are not visited in their order in memory."""
    first = e * _U(n)
    for k in range(_0, _U(n), _U(LANES)):
        prefetch(array, first + k)
    prefetch(array, first + _U(n - 1))


@numba.njit(**FLAGS)
def residual_sums(cells, displacement, reference, deformed, all_kinds, sums):
    """Accumulate, per cell, moments of the residual against grad f and the monomials, and plain sums.

    ``displacement`` holds the coefficients of u on the monomials, (n_cells, 2, 4), pixels; ``deformed`` is a window of
    g that holds all x + u(x) that lie in the image. With ``all_kinds`` the moments of g and of 1 are accumulated too,
    which a grey correction needs, and for which ``sums`` has room.
    """
    scratch = _new_scratch()
    flat_geometry = cells.geometry.reshape(-1)
    flat_moments, flat_grey = sums.moments.reshape(-1), sums.grey.reshape(-1)
    for visit in range(len(cells.order)):
        e = _U(cells.order[visit])
        if visit + AHEAD < len(cells.order):
            later = _U(cells.order[visit + AHEAD])
            _fetch_numbers(flat_geometry, later, 8)
            _fetch_numbers(flat_moments, later, 24 if all_kinds else 8)
            _fetch_numbers(flat_grey, later, N_SUMS)
        demand = _demand(cells, displacement, reference, deformed, visit)
        place = _begin_cell(cells, e)
        while place.run < place.last_run:
            batch, place = _take_batch(cells, reference, e, place, scratch)
            if batch.n_segments == 0:
                continue
            demand = _evaluate_deformed(cells, displacement, reference, deformed, batch, demand, scratch)
            _add_residual_sums(batch, scratch, sums)
            if all_kinds:
                for kind in range(1, 3):
                    _add_moments(kind, batch, scratch, sums)
        while demand.run < demand.last_run:
            demand = _fetch_row(cells, reference, deformed, demand)


@numba.njit(**FLAGS)
def fill_residual_pixels(cells, displacement, reference, deformed, correction, out):
    """Write f - gain g(x + u) - offset of all cells' pixels.

    ``displacement`` and ``deformed`` are those of ``residual_sums``. ``correction`` are gain, and offset in grey
    levels, of each cell, (2, n_cells). ``out`` has the reference window's shape, float32, grey levels; NaN where a
    cell's pixel does not count.
    """
    gain, offset = correction[0], correction[1]
    scratch = _new_scratch()
    flat_out = out.reshape(-1)
    # Slopes are not needed: what is read in their place is in the cache.
    values = ReferencePixels(reference.values, reference.values, reference.values, reference.row_length,
                             reference.x0, reference.y0, reference.usable)
    for visit in range(len(cells.order)):
        e = _U(cells.order[visit])
        if visit + AHEAD < len(cells.order):
            later = _U(cells.order[visit + AHEAD])
            _fetch_rows(flat_out, out.shape[1], reference.x0, reference.y0, cells, later)
        demand = _demand(cells, displacement, reference, deformed, visit)
        place = _begin_cell(cells, e)
        while place.run < place.last_run:
            batch, place = _take_batch(cells, values, e, place, scratch)
            if batch.n_segments == 0:
                continue
            demand = _evaluate_deformed(cells, displacement, reference, deformed, batch, demand, scratch)
            for s in range(batch.n_segments):
                segment = _segment(scratch, s)
                row, column = segment.y - reference.y0, segment.x - reference.x0
                i_f, i_out = _U(row * reference.row_length + column), _U(row * out.shape[1] + column)
                lane = _U(segment.lane)
                for k in range(_U(segment.length)):
                    g = scratch.lanes[k + lane + _G]
                    r = reference.values[k + i_f] - gain[e] * g - offset[e]
                    flat_out[k + i_out] = r if scratch.lanes[k + lane + _WEIGHT] > 0.0 else np.nan
        while demand.run < demand.last_run:
            demand = _fetch_row(cells, values, deformed, demand)


@numba.njit(**INLINED)
def _add_products(component, batch, scratch, S):
    """Add the lanes' sums of one component of grad f grad f^T x xi^i eta^j to S[component] (3, 3)."""
    lanes, pixels = scratch.lanes, scratch.pixels
    a00 = a10 = a20 = a01 = a11 = a21 = a02 = a12 = a22 = 0.0
    one, other = _BY_Y if component == 2 else _BY_X, _BY_X if component == 0 else _BY_Y
    for k in range(batch.n_lanes):
        # In float64: the product of two float32 numbers would be rounded.
        w = lanes[k + _WEIGHT] * pixels[k + one] * pixels[k + other]
        t, s = lanes[k + _XI], lanes[k + _ETA]
        wt, ws = w * t, w * s
        wtt, wts, wss = wt * t, wt * s, ws * s
        a00 += w
        a10 += wt
        a01 += ws
        a20 += wtt
        a11 += wts
        a02 += wss
        a21 += wtt * s
        a12 += wts * s
        a22 += wtt * s * s
    S[component, 0, 0] += a00
    S[component, 1, 0] += a10
    S[component, 2, 0] += a20
    S[component, 0, 1] += a01
    S[component, 1, 1] += a11
    S[component, 2, 1] += a21
    S[component, 0, 2] += a02
    S[component, 1, 2] += a12
    S[component, 2, 2] += a22


@numba.njit(**INLINED)
def _add_linear_products(batch, scratch, S):
    """Add the lanes' sums of all components that cells without the monomial xi eta need to S (3, 3, 3)."""
    lanes, pixels = scratch.lanes, scratch.pixels
    a00 = a10 = a20 = a01 = a11 = a02 = 0.0
    b00 = b10 = b20 = b01 = b11 = b02 = 0.0
    c00 = c10 = c20 = c01 = c11 = c02 = 0.0
    for k in range(batch.n_lanes):
        t, s = lanes[k + _XI], lanes[k + _ETA]
        x, y = lanes[k + _WEIGHT] * pixels[k + _BY_X], np.float64(pixels[k + _BY_Y])
        a, b, c = x * pixels[k + _BY_X], x * y, lanes[k + _WEIGHT] * y * y
        at, bt, ct = a * t, b * t, c * t
        as_, bs, cs = a * s, b * s, c * s
        a00 += a
        a10 += at
        a01 += as_
        a20 += at * t
        a11 += at * s
        a02 += as_ * s
        b00 += b
        b10 += bt
        b01 += bs
        b20 += bt * t
        b11 += bt * s
        b02 += bs * s
        c00 += c
        c10 += ct
        c01 += cs
        c20 += ct * t
        c11 += ct * s
        c02 += cs * s
    for component, sums in enumerate(((a00, a10, a20, a01, a11, a02), (b00, b10, b20, b01, b11, b02),
                                      (c00, c10, c20, c01, c11, c02))):
        S[component, 0, 0] += sums[0]
        S[component, 1, 0] += sums[1]
        S[component, 2, 0] += sums[2]
        S[component, 0, 1] += sums[3]
        S[component, 1, 1] += sums[4]
        S[component, 0, 2] += sums[5]


@numba.njit(**FLAGS)
def _multiply_shapes(coefficients):
    """Coefficients of N_a N_b on xi^i eta^j, (n_kinds, 3, 3, 16), from those of N_a (n_kinds, 4, 4)."""
    T = coefficients
    W = np.zeros((len(T), 3, 3, 16))
    for kind in range(len(T)):
        for a in range(4):
            for b in range(4):
                for m in range(4):
                    for n in range(4):
                        W[kind, m % 2 + n % 2, m // 2 + n // 2, 4 * a + b] += T[kind, a, m] * T[kind, b, n]
    return W


@numba.njit(**INLINED)
def _combine_products(S, W, e, product, out):
    """Write M_e into out[e] (4, 2, 4, 2) from sums S (3 components, 3, 3) and products of shapes W (3, 3, 16).

    product: (16,) scratch.
    """
    for component in range(3):
        for ab in range(16):
            value = 0.0
            for i in range(3):
                for j in range(3):
                    value += S[component, i, j] * W[i, j, ab]
            product[ab] = value
        c, d = (0, 0) if component == 0 else ((0, 1) if component == 1 else (1, 1))
        for a in range(4):
            for b in range(4):
                out[e, a, c, b, d] = out[e, a, d, b, c] = product[4 * a + b]


@numba.njit(**INLINED)
def _has_linear_shapes(shapes, e):
    """Whether no shape function of cell e has the monomial xi eta."""
    linear = True
    for a in range(4):
        linear = linear and shapes.coefficients[shapes.kinds[e], a, 3] == 0.0
    return linear


@numba.njit(**FLAGS)
def hessian_cells(cells, shapes, reference, out):
    """Assemble M_e = sum_px N_a N_b grad f grad f^T of every cell, Eq. 7 of [BP17].

    Shape functions are polynomials, so that sums of grad f grad f^T xi^i eta^j, i, j <= 2, give all their products.
    ``out`` is (n_cells, 4, 2, 4, 2) by a, component, b, component; grey levels squared per pixel squared.
    """
    scratch = _new_scratch()
    flat_geometry, flat_out = cells.geometry.reshape(-1), out.reshape(-1)
    S, product = np.empty((3, 3, 3)), np.empty(16)
    W = _multiply_shapes(shapes.coefficients)
    # Values are not needed: what is read in their place is in the cache.
    slopes = ReferencePixels(reference.by_x, reference.by_x, reference.by_y, reference.row_length,
                             reference.x0, reference.y0, reference.usable)
    for visit in range(len(cells.order)):
        e = _U(cells.order[visit])
        if visit + AHEAD < len(cells.order):
            later = _U(cells.order[visit + AHEAD])
            _fetch_reference(slopes, cells, later)
            _fetch_numbers(flat_geometry, later, 8)
            _fetch_numbers(flat_out, later, 64)
        S[:] = 0.0
        linear = _has_linear_shapes(shapes, e)
        place = _begin_cell(cells, e)
        while place.run < place.last_run:
            batch, place = _take_batch(cells, slopes, e, place, scratch)
            if batch.n_segments == 0:
                continue
            _find_local_coordinates(cells.geometry, batch, scratch)
            _weigh(slopes, batch, scratch)
            if linear:
                _add_linear_products(batch, scratch, S)
            else:
                for component in range(3):
                    _add_products(component, batch, scratch, S)
        _combine_products(S, W[shapes.kinds[e]], e, product, out)


@dataclass(frozen=True)
class PixelKernels:
    """Sums over pixels for the cell types of one family, and what they take images and cells as.

    Attributes
    ----------
    hessian_cells, residual_sums, fill_residual_pixels : callable
        M_e; moments and grey sums of the residual; the residual itself: functions with the arguments of those of this
        module.
    convert_reference : callable
        From a GradientImage.
    convert_deformed : callable
        From a SplineImage, and the box of the whole image.
    take_cells : callable
        From the numbers of cells in the order of visiting, their CellInterpolation and their Raster.
    """

    hessian_cells: Callable[..., None]
    residual_sums: Callable[..., None]
    fill_residual_pixels: Callable[..., None]
    convert_reference: Callable[[GradientImage], Any]
    convert_deformed: Callable[[SplineImage, Window], Any]
    take_cells: Callable[[IntArray, CellInterpolation, Raster], Any]


def convert_reference(f: GradientImage) -> ReferencePixels:
    """Convert a window of the reference image; its arrays are not copied."""
    by_x, by_y = map(flatten, f.slopes)
    return ReferencePixels(flatten(f.values), by_x, by_y, count_step(f.values, 0), f.window.x0, f.window.y0,
                           _NOTHING_EXCLUDED if f.usable is None else f.usable)


def convert_deformed(g: SplineImage, extent: Window) -> DeformedPixels:
    """Convert a window of the deformed image, ``extent`` being the whole one; its arrays are not copied."""
    return DeformedPixels(flatten(g.coefficients), count_step(g.coefficients, 0), g.degree, g.window.x0, g.window.y0,
                          _NOTHING_EXCLUDED if g.usable is None else g.usable, *extent.sizes)


_NOTHING_EXCLUDED = np.zeros((0, 0), dtype=np.uint8)
"""Where nothing can be excluded, so that kernels are compiled once."""


def flatten(image: NDArray[Any]) -> NDArray[Any]:
    """Give an image, or a part of one, as one sequence of rows, which ``count_step`` is from one to the next."""
    if image.flags.c_contiguous:
        return image.reshape(-1)
    n = sum((size - 1) * count_step(image, axis) for axis, size in enumerate(image.shape)) + 1
    return as_strided(image, (n,), (image.itemsize,))


def count_step(image: NDArray[Any], axis: int) -> int:
    """Count the numbers from one row of an image, or of a part of one, to the next; or from one plane."""
    return int(image.strides[axis] // image.itemsize)


def take_cells(order: IntArray, interpolation: CellInterpolation, raster: Raster) -> Cells:
    """Take cells as kernels do, in the order of visiting."""
    return Cells(order, interpolation.geometry, raster.first_rows[:, 0], raster.row_ptr, raster.starts, raster.stops)


COMPILED = PixelKernels(hessian_cells, residual_sums, fill_residual_pixels, convert_reference, convert_deformed,
                        take_cells)
"""Of types whose shape functions are polynomials of (1, xi, eta, xi eta)."""
