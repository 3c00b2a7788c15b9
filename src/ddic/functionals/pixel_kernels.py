"""Compiled loops over the pixels of cells, fused with the assembly of cell sums.

Cells are visited in batches of segments: neighbouring pixels of one row each. Segments of a batch follow each other
without gaps, so that short rows fill vectors as well as long ones, and only what reads images goes row by row: it
writes whole vectors, and the next segment overwrites what is beyond a segment's end. All else is a loop over the
batch's lanes, which the compiler turns into vector instructions without a remainder; lanes after the last segment
repeat its last pixel's position and weigh nothing. Segments whose pixels have one integer offset read spline
coefficients contiguously. Displacements are split into an integer offset and a fraction, so that
no digit is lost to the position in the image. Images are float32 and everything computed from them is float64: in
float32, Gauss-Newton would not get below 5e-8 px.

The stages share this file because numba's cache of a kernel does not notice changes in other files.
"""
# mypy: disable-error-code="no-untyped-def, assignment"

from __future__ import annotations

import numba
import numpy as np

from ddic.functionals.prefetch import prefetch
from ddic.functionals.vector_moves import WIDTH, copy_some, copy_vector, count_vector, fill_vector

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

INLINED = {**FLAGS, "forceinline": True}
"""Of what is called for every cell: without it, code loaded from the cache was slower than just compiled."""

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

# Unsigned, so that numba need not allow for negative indices: that keeps loops from being vectorised, and outside
# them costs as much as the arithmetic on a pixel.
_U = np.uint64
_XI, _ETA, _TX, _TY, _WEIGHT, _G = (_U(k * PLANE) for k in range(6))
"""Where a batch's quantities begin in one scratch array ``lanes``. One array, because the compiler then knows them
apart, and because it has too few registers for the addresses of many."""

_COLUMN, _ROW, _F, _BY_X, _BY_Y = (_U(k * PLANE) for k in range(5))
"""The same in ``pixels``, float32: pixels' columns and rows from the cell's first, f and grad f."""

_OX, _OY = (_U(k * PLANE) for k in range(2))
"""The same in ``offsets``: integer parts of the displacements."""

_SEG_X, _SEG_Y, _SEG_N, _SEG_AT, _RUN_AT, _RUN_BEGIN, _RUN_END = (_U(k * PLANE) for k in range(7))
"""The same in ``bounds``: segments' column, row, length and first lane (and of the one after the last the first lane);
runs' first coefficient, first lane and the lane after the last."""

_0, _1 = _U(0), _U(1)


@numba.njit(**INLINED)
def _padded(n):
    """n, rounded up to a multiple of LANES."""
    return _U((n + (LANES - 1)) & -LANES)


@numba.njit(**INLINED)
def _segment(bounds, s):
    """Column, row, length and first lane of segment s."""
    s = _U(s)
    return bounds[s + _SEG_X], bounds[s + _SEG_Y], bounds[s + _SEG_N], bounds[s + _SEG_AT]


@numba.njit(**INLINED)
def _take_batch(row, last_row, x, y, x0, y0, starts, stops, f, gx, gy, f_width, fx0, fy0, pixels, bounds):
    """Fill a batch from column x of a cell's run ``row``: segments and their pixels.

    That is columns from x0 and rows from y0, f and grad f.
    Each segment is written in whole vectors, and what is beyond its end by the next one. The last pixel's position
    is repeated. Returns the numbers of segments and of lanes, and where to go on: row, x, y.
    """
    n, at, last = _0, 0, f.size - WIDTH
    while row < last_row and at < BATCH:
        x = max(x, starts[row])
        length = min(stops[row] - x, LONGEST, BATCH - at)
        if length > 0:
            bounds[n + _SEG_X], bounds[n + _SEG_Y], bounds[n + _SEG_N], bounds[n + _SEG_AT] = x, y, length, at
            column, line = np.float32(x - x0), np.float32(y - y0)
            i, j, end = (y - fy0) * f_width + x - fx0, at, at + length
            while j < end:
                to = _U(j)
                count_vector(pixels, to + _COLUMN, column)
                fill_vector(pixels, to + _ROW, line)
                if i <= last:
                    copy_vector(pixels, to + _F, f, i)
                    copy_vector(pixels, to + _BY_X, gx, i)
                    copy_vector(pixels, to + _BY_Y, gy, i)
                else:
                    copy_some(pixels, to + _F, f, i, end - j)
                    copy_some(pixels, to + _BY_X, gx, i, end - j)
                    copy_some(pixels, to + _BY_Y, gy, i, end - j)
                i += WIDTH
                j += WIDTH
                column += np.float32(WIDTH)
            x += length
            at = end
            n += _1
        if x >= stops[row]:
            row += _1
            y += 1
            x = FROM_START
    bounds[n + _SEG_AT] = at
    end, n_lanes = _U(at), _U((at + UNROLLED - 1) // UNROLLED * UNROLLED)
    if at > 0:
        column, line = pixels[end - _1 + _COLUMN], pixels[end - _1 + _ROW]
        for k in range(n_lanes - end):
            pixels[k + end + _COLUMN] = column
            pixels[k + end + _ROW] = line
    return np.int64(n), n_lanes, row, x, y


@numba.njit(**INLINED)
def _local_coordinates(X, e, x0, y0, n, pixels, lanes):
    """Invert x = X[e] phi(xi, eta) at n lanes: linear in a parallelogram, else two quadratics."""
    x0, y0 = x0 - X[e, 0, 0], y0 - X[e, 1, 0]
    ef = X[e, 0, 1] * X[e, 1, 2] - X[e, 1, 1] * X[e, 0, 2]
    e0, e1, f0, f1 = X[e, 0, 1] / ef, X[e, 1, 1] / ef, X[e, 0, 2] / ef, X[e, 1, 2] / ef
    g0, g1 = X[e, 0, 3] / ef, X[e, 1, 3] / ef
    if abs(g0) + abs(g1) <= AFFINE * (abs(e0) + abs(e1) + abs(f0) + abs(f1)):
        for k in range(n):
            x, y = x0 + pixels[k + _COLUMN], y0 + pixels[k + _ROW]
            lanes[k + _XI] = f1 * x - f0 * y
            lanes[k + _ETA] = e0 * y - e1 * x
        return
    # Of the quadratics a t^2 + b t + c = 0 for eta and for xi, whose slopes at the solution are s and -s.
    a_eta, a_xi = (g0 * f1 - g1 * f0) * ef, (g0 * e1 - g1 * e0) * ef
    if 1.0 - abs(a_eta) - abs(a_xi) < DISTORTED:
        for k in range(n):
            x, y = x0 + pixels[k + _COLUMN], y0 + pixels[k + _ROW]
            hg, c_eta, c_xi = x * g1 - y * g0, x * e1 - y * e0, x * f1 - y * f0
            s = np.sqrt(max((1.0 + hg) * (1.0 + hg) - 4.0 * a_eta * c_eta, 0.0))
            lanes[k + _XI], lanes[k + _ETA] = 2.0 * c_xi / (1.0 - hg + s), -2.0 * c_eta / (1.0 + hg + s)
        return
    # A root and a reciprocal in float32, and a step of Newton's, spare a root and two divisions in float64.
    a4 = np.float32(4.0 * a_eta)
    for k in range(n):
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
def _displace(D, e, n, lanes, offsets):
    """Split u = D[e] phi of n lanes into integer offsets and fractions; returns the least and largest offsets."""
    u0, u1, u2, u3 = D[e, 0, 0], D[e, 0, 1], D[e, 0, 2], D[e, 0, 3]
    v0, v1, v2, v3 = D[e, 1, 0], D[e, 1, 1], D[e, 1, 2], D[e, 1, 3]
    least_x, least_y, most_x, most_y = np.int32(2**31 - 1), np.int32(2**31 - 1), np.int32(-(2**31)), np.int32(-(2**31))
    for k in range(n):
        t, s = lanes[k + _XI], lanes[k + _ETA]
        p = t * s
        u = u0 + u1 * t + u2 * s + u3 * p
        v = v0 + v1 * t + v2 * s + v3 * p
        fu, fv = np.floor(u), np.floor(v)
        lanes[k + _TX], lanes[k + _TY] = u - fu, v - fv
        i, j = np.int32(fu), np.int32(fv)
        offsets[k + _OX], offsets[k + _OY] = i, j
        least_x, least_y = min(least_x, i), min(least_y, j)
        most_x, most_y = max(most_x, i), max(most_y, j)
    return least_x, least_y, most_x, most_y


@numba.njit(**FLAGS)
def _keep_inside(D, e, at, x0, y, n, width, height, lanes, offsets):
    """Give the n lanes from ``at`` whose x + u leaves the image the nearest position in it and no weight."""
    for k in range(n):
        j = _U(at + k)
        t, s = lanes[j + _XI], lanes[j + _ETA]
        x = x0 + k
        px = x + (D[e, 0, 0] + D[e, 0, 1] * t + D[e, 0, 2] * s + D[e, 0, 3] * (t * s))
        py = y + (D[e, 1, 0] + D[e, 1, 1] * t + D[e, 1, 2] * s + D[e, 1, 3] * (t * s))
        if not (0.0 <= px <= width - 1.0 and 0.0 <= py <= height - 1.0):
            lanes[j + _WEIGHT] = 0.0
            # Written so that a position that is not a number becomes 0.
            px = px if px > 0.0 else 0.0
            py = py if py > 0.0 else 0.0
            px, py = min(px, width - 1.0), min(py, height - 1.0)
            fx, fy = np.floor(px), np.floor(py)
            offsets[j + _OX], offsets[j + _OY] = np.int32(fx) - x, np.int32(fy) - y
            lanes[j + _TX], lanes[j + _TY] = px - fx, py - fy


@numba.njit(**INLINED)
def _cubic(c, stride, n_runs, bounds, lanes):
    """Evaluate the cubic spline at the lanes of runs; c: its coefficients, flat, in rows of ``stride``."""
    d1, d2, d3 = _U(stride), _U(2 * stride), _U(3 * stride)
    for run in range(_U(n_runs)):
        first, begin, end = _U(bounds[run + _RUN_AT]), _U(bounds[run + _RUN_BEGIN]), _U(bounds[run + _RUN_END])
        for k in range(end - begin):
            t, s = lanes[k + begin + _TX], lanes[k + begin + _TY]
            u, v = 1.0 - t, 1.0 - s
            # The last weight is what the others leave to 1, so that constants are kept to rounding.
            x0, x3, x1 = u * u * u * (1 / 6), t * t * t * (1 / 6), (2 / 3) - 0.5 * t * t * (1.0 + u)
            y0, y3, y1 = v * v * v * (1 / 6), s * s * s * (1 / 6), (2 / 3) - 0.5 * s * s * (1.0 + v)
            x2 = 1.0 - x0 - x1 - x3
            y2 = 1.0 - y0 - y1 - y3
            i = first + k
            a0 = y0 * c[i] + y1 * c[i + d1] + y2 * c[i + d2] + y3 * c[i + d3]
            i += _U(1)
            a1 = y0 * c[i] + y1 * c[i + d1] + y2 * c[i + d2] + y3 * c[i + d3]
            i += _U(1)
            a2 = y0 * c[i] + y1 * c[i + d1] + y2 * c[i + d2] + y3 * c[i + d3]
            i += _U(1)
            a3 = y0 * c[i] + y1 * c[i + d1] + y2 * c[i + d2] + y3 * c[i + d3]
            lanes[k + begin + _G] = x0 * a0 + x1 * a1 + x2 * a2 + x3 * a3


@numba.njit(**FLAGS)
def _quintic_weights(t):
    u = 1.0 - t
    t2, u2 = t * t, u * u
    w0, w5 = u2 * u2 * u * (1 / 120), t2 * t2 * t * (1 / 120)
    w1 = (26 / 120) + t * ((-50 / 120) + t * ((20 / 120) + t * (
        (20 / 120) + t * ((-20 / 120) + (5 / 120) * t))))
    w4 = (26 / 120) + u * ((-50 / 120) + u * ((20 / 120) + u * (
        (20 / 120) + u * ((-20 / 120) + (5 / 120) * u))))
    w2 = (66 / 120) + t2 * ((-60 / 120) + t2 * ((30 / 120) - (10 / 120) * t))
    return w0, w1, w2, 1.0 - w0 - w1 - w2 - w4 - w5, w4, w5


@numba.njit(**FLAGS)
def _quintic(c, stride, n_runs, bounds, lanes):
    """Evaluate the quintic spline at the lanes of runs; c: its coefficients, flat, in rows of ``stride``."""
    d = _U(stride)
    for run in range(_U(n_runs)):
        first, begin, end = _U(bounds[run + _RUN_AT]), _U(bounds[run + _RUN_BEGIN]), _U(bounds[run + _RUN_END])
        for k in range(end - begin):
            x0, x1, x2, x3, x4, x5 = _quintic_weights(lanes[k + begin + _TX])
            y0, y1, y2, y3, y4, y5 = _quintic_weights(lanes[k + begin + _TY])
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
def _find_runs(uniform, size, stride, reach, down, right, n_segments, bounds, offsets):
    """Split segments into runs of one integer offset; returns the number of runs.

    uniform: all lanes have one offset; size: of the coefficients; down, right: from a displaced pixel to its first
    coefficient. A run that is a whole segment is padded as the segment is, if the coefficients go on so far.
    """
    span = reach * (stride + 1)
    if uniform:
        first = (offsets[_OY] + down) * stride + offsets[_OX] + right
        for s in range(_U(n_segments)):
            x, y, n, j = _segment(bounds, s)
            at = y * stride + x + first
            padded = np.int64(_padded(n))
            bounds[s + _RUN_AT], bounds[s + _RUN_BEGIN] = at, j
            bounds[s + _RUN_END] = j + (padded if at + span + padded <= size else n)
        return n_segments
    n_runs = _0
    for s in range(n_segments):
        x, y, n, j = _segment(bounds, s)
        differ = np.int32(0)
        for k in range(_U(n)):
            differ |= ((offsets[k + _U(j) + _OX] ^ offsets[_U(j) + _OX])
                       | (offsets[k + _U(j) + _OY] ^ offsets[_U(j) + _OY]))
        begin = np.int64(0)
        while begin < n:
            i, end = _U(j + begin), n
            ox, oy = offsets[i + _OX], offsets[i + _OY]
            if differ != 0:
                end = begin + 1
                while end < n and offsets[_U(j + end) + _OX] == ox and offsets[_U(j + end) + _OY] == oy:
                    end += 1
            at = (y + oy + down) * stride + x + begin + ox + right
            padded = np.int64(_padded(end - begin))
            bounds[n_runs + _RUN_AT], bounds[n_runs + _RUN_BEGIN] = at, j + begin
            bounds[n_runs + _RUN_END] = j + begin + padded if at + span + padded <= size else j + end
            n_runs += _1
            begin = end
    return np.int64(n_runs)


@numba.njit(**INLINED)
def _weigh(n, n_segments, bounds, f_usable, fx0, fy0, lanes):
    """Weight 1 for those of n lanes that are pixels which f does not exclude, else 0."""
    end = np.int32(bounds[_U(n_segments) + _SEG_AT])
    for k in range(n):
        lanes[k + _WEIGHT] = 1.0 if np.int32(k) < end else 0.0
    if f_usable.size > 0:
        for s in range(n_segments):
            x, y, length, at = _segment(bounds, s)
            for k in range(length):
                lanes[_U(at + k) + _WEIGHT] *= f_usable[y - fy0, x - fx0 + k]


@numba.njit(**INLINED)
def _deformed_values(X, D, e, x0, y0, n, n_segments, f_usable, fx0, fy0,
                     spline, stride, degree, origin_x, origin_y, width, height, g_usable,
                     lanes, pixels, offsets, bounds):
    """Evaluate g at x + u(x) and the weights of a batch: 0 where x + u leaves the image, or f or g excludes it.

    origin_x, origin_y: the spline window's first pixel; width, height: the whole image's size.
    """
    _local_coordinates(X, e, x0, y0, n, pixels, lanes)
    _weigh(n, n_segments, bounds, f_usable, fx0, fy0, lanes)
    least_x, least_y, most_x, most_y = _displace(D, e, n, lanes, offsets)
    left, right = np.int64(2**40), np.int64(-(2**40))
    for s in range(n_segments):
        x, y, length, _ = _segment(bounds, s)
        left, right = min(left, x), max(right, x + length)
    uniform = least_x == most_x and least_y == most_y
    if (left + least_x < 0 or right + most_x >= width or bounds[_SEG_Y] + least_y < 0 or y + most_y + 1 >= height):
        uniform = False
        for s in range(n_segments):
            x, y, length, at = _segment(bounds, s)
            _keep_inside(D, e, at, x, y, length, width, height, lanes, offsets)
    # Taps of a pixel's first coefficient lie degree // 2 pixels before it, and the array begins one more before.
    n_runs = _find_runs(uniform, spline.size, stride, degree, 1 - origin_y, 1 - origin_x, n_segments, bounds, offsets)
    if degree == 3:
        _cubic(spline, stride, n_runs, bounds, lanes)
    else:
        _quintic(spline, stride, n_runs, bounds, lanes)
    if g_usable.size > 0:
        for s in range(n_segments):
            x, y, length, at = _segment(bounds, s)
            for k in range(length):
                j = _U(at + k)
                lanes[j + _WEIGHT] *= g_usable[y + offsets[j + _OY] - origin_y, x + k + offsets[j + _OX] - origin_x]


@numba.njit(**INLINED)
def _add_residual_sums(n, pixels, lanes, moments, sums, e):
    """Add the n lanes' sums of r grad f times the monomials to moments[e, 0], and their grey sums to sums[e]."""
    m00 = m01 = m02 = m03 = m10 = m11 = m12 = m13 = 0.0
    s0 = s1 = s2 = s3 = s4 = s5 = 0.0
    for k in range(n):
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
        sums[e, k] += value
    for k, value in enumerate((m00, m01, m02, m03)):
        moments[e, 0, 0, k] += value
    for k, value in enumerate((m10, m11, m12, m13)):
        moments[e, 0, 1, k] += value


@numba.njit(**FLAGS)
def _add_moments(kind, n, pixels, lanes, moments, e):
    """Add the n lanes' sums of g (kind 1) or 1 (2) times grad f and the monomials to moments[e, kind] (2, 4)."""
    m00 = m01 = m02 = m03 = m10 = m11 = m12 = m13 = 0.0
    for k in range(n):
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
        moments[e, kind, 0, k] += value
    for k, value in enumerate((m10, m11, m12, m13)):
        moments[e, kind, 1, k] += value


@numba.njit(**FLAGS)
def _aligned(array):
    """The array from the first number on that begins a line of the cache: a vector across two lines takes two loads."""
    ahead = -np.int64(array.ctypes.data) & (4 * LINE - 1)
    return array[ahead // array.itemsize:]


@numba.njit(**FLAGS)
def _scratch():
    """Buffers of a batch: lanes, pixels, offsets, bounds.

    Zeros, since a lane that is no pixel must be a number for its product with weight 0 to be 0.
    """
    return (_aligned(np.zeros(7 * PLANE)), _aligned(np.zeros(6 * PLANE, np.float32)),
            _aligned(np.zeros(3 * PLANE, np.int32)), _aligned(np.zeros(8 * PLANE, np.int64)))


@numba.njit(**INLINED)
def _fetch(array, width, e, right, down, first_row, row_ptr, starts, stops):
    """Ask for the pixels of cell e in a flat array of rows of ``width``, moved by so many columns and rows.

    And for the line after each row, where the next cell is likely to begin.
    """
    begin = (first_row[e] + down) * width + right
    for row in range(_U(row_ptr[e]), _U(row_ptr[e + _1])):
        x, stop = begin + starts[row], begin + stops[row] + 2 * LINE - 1
        while x < stop:
            prefetch(array, x)
            x += LINE
        begin += width


@numba.njit(**INLINED)
def _fetch_three(a, b, c, width, e, right, down, first_row, row_ptr, starts, stops):
    """The same in three arrays at once."""
    begin = (first_row[e] + down) * width + right
    for row in range(_U(row_ptr[e]), _U(row_ptr[e + _1])):
        x, stop = begin + starts[row], begin + stops[row] + 2 * LINE - 1
        while x < stop:
            prefetch(a, x)
            prefetch(b, x)
            prefetch(c, x)
            x += LINE
        begin += width


@numba.njit(**INLINED)
def _fetch_numbers(array, e, n):
    """Ask for the n float64 numbers of cell e in a flat array: cells are not visited in their order in memory."""
    first = e * _U(n)
    for k in range(_0, _U(n), _U(LANES)):
        prefetch(array, first + k)
    prefetch(array, first + _U(n - 1))


@numba.njit(**FLAGS)
def residual_sums(order, X, U, first_row, row_ptr, starts, stops,
                  f, gx, gy, f_width, f_usable, fx0, fy0,
                  spline, stride, degree, origin_x, origin_y, width, height, g_usable, all_kinds,
                  moments, sums):
    """Accumulate, per cell, moments of the residual against grad f and the monomials, and plain sums.

    order: (n_cells,) the cells in the order of visiting, so that neighbours find their pixels in the cache.
    X, U: (n_cells, 2, 4) geometry and displacement coefficients on the monomials.
    f, gx, gy, spline: flat, rows of f_width and of stride pixels.
    moments: (n_cells, 3, 2, 4), sums of (r, g, 1) x (f_x, f_y) x (1, xi, eta, xi eta); the last two
    kinds only where all_kinds. sums: (n_cells, N_SUMS).
    """
    scratch = _scratch()
    lanes, pixels, _, bounds = scratch
    flat_X, flat_moments, flat_sums = X.reshape(-1), moments.reshape(-1), sums.reshape(-1)
    for i in range(len(order)):
        e = _U(order[i])
        if i + AHEAD < len(order):
            after = _U(order[i + AHEAD])
            right, down = np.int64(np.floor(U[after, 0, 0])) - origin_x, np.int64(np.floor(U[after, 1, 0])) - origin_y
            _fetch(spline, stride, after, right + 1, down + degree + 1, first_row, row_ptr, starts, stops)
            _fetch_three(f, gx, gy, f_width, after, -fx0, -fy0, first_row, row_ptr, starts, stops)
            _fetch_numbers(flat_X, after, 8)
            _fetch_numbers(flat_moments, after, 24)
            _fetch_numbers(flat_sums, after, N_SUMS)
        row, last_row, x, y = _U(row_ptr[e]), _U(row_ptr[e + _1]), FROM_START, first_row[e]
        x0, y0 = (starts[row], y) if row < last_row else (np.int32(0), y)
        while row < last_row:
            n_segments, n, row, x, y = _take_batch(row, last_row, x, y, x0, y0, starts, stops, f, gx, gy, f_width,
                                                   fx0, fy0, pixels, bounds)
            if n_segments == 0:
                continue
            _deformed_values(X, U, e, x0, y0, n, n_segments, f_usable, fx0, fy0,
                             spline, stride, degree, origin_x, origin_y, width, height, g_usable, *scratch)
            _add_residual_sums(n, pixels, lanes, moments, sums, e)
            if all_kinds:
                for kind in range(1, 3):
                    _add_moments(kind, n, pixels, lanes, moments, e)


@numba.njit(**FLAGS)
def residual_pixels(X, U, first_row, row_ptr, starts, stops, f, f_width, f_usable, fx0, fy0,
                    spline, stride, degree, origin_x, origin_y, width, height, g_usable, gain, offset, out):
    """Write f - gain g(x + u) - offset into out (the reference window's shape), NaN where a pixel is left out.

    f, spline: flat, rows of f_width and of stride pixels. gain, offset: (n_cells,).
    """
    scratch = _scratch()
    lanes, pixels, _, bounds = scratch
    for e in range(_U(len(first_row))):
        row, last_row, x, y = _U(row_ptr[e]), _U(row_ptr[e + _1]), FROM_START, first_row[e]
        x0, y0 = (starts[row], y) if row < last_row else (np.int32(0), y)
        while row < last_row:
            n_segments, n, row, x, y = _take_batch(row, last_row, x, y, x0, y0, starts, stops, f, f, f, f_width,
                                                   fx0, fy0, pixels, bounds)
            if n_segments == 0:
                continue
            _deformed_values(X, U, e, x0, y0, n, n_segments, f_usable, fx0, fy0,
                             spline, stride, degree, origin_x, origin_y, width, height, g_usable, *scratch)
            for s in range(n_segments):
                left, top, length, at = _segment(bounds, s)
                for k in range(length):
                    i, j, lane = top - fy0, left + k - fx0, _U(at + k)
                    used = lanes[lane + _WEIGHT] > 0.0
                    out[i, j] = f[i * f_width + j] - gain[e] * lanes[lane + _G] - offset[e] if used else np.nan


@numba.njit(**INLINED)
def _add_products(n, component, pixels, lanes, S):
    """Add the n lanes' sums of one component of grad f grad f^T x xi^i eta^j to S[component] (3, 3)."""
    a00 = a10 = a20 = a01 = a11 = a21 = a02 = a12 = a22 = 0.0
    one, other = _BY_Y if component == 2 else _BY_X, _BY_X if component == 0 else _BY_Y
    for k in range(n):
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
def _add_linear_products(n, pixels, lanes, S):
    """Add the n lanes' sums of all components that cells without the monomial xi eta need to S (3, 3, 3)."""
    a00 = a10 = a20 = a01 = a11 = a02 = 0.0
    b00 = b10 = b20 = b01 = b11 = b02 = 0.0
    c00 = c10 = c20 = c01 = c11 = c02 = 0.0
    for k in range(n):
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
def _products_of_shapes(T):
    """Coefficients of N_a N_b on xi^i eta^j: (n_kinds, 3, 3, 16) from shapes T (n_kinds, 4, 4)."""
    W = np.zeros((len(T), 3, 3, 16))
    for kind in range(len(T)):
        for a in range(4):
            for b in range(4):
                for m in range(4):
                    for n in range(4):
                        W[kind, m % 2 + n % 2, m // 2 + n // 2, 4 * a + b] += T[kind, a, m] * T[kind, b, n]
    return W


@numba.njit(**INLINED)
def _transform(S, W, e, product, out):
    """M_e into out[e] (4, 2, 4, 2) from sums S (3 components, 3, 3) and products of shapes W (3, 3, 16).

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


@numba.njit(**FLAGS)
def hessian_cells(order, X, T, kinds, first_row, row_ptr, starts, stops, gx, gy, f_width, f_usable, fx0, fy0, out):
    """Assemble M_e = sum_px N_a N_b grad f grad f^T of every cell into out (n_cells, 4, 2, 4, 2), Eq. 5 of [BP17].

    order: (n_cells,) the cells in the order of visiting; gx, gy: flat, rows of f_width pixels.
    X: (n_cells, 2, 4) geometry; T: (n_kinds, 4, 4) shape coefficients on the monomials; kinds: (n_cells,) cells' T.
    """
    lanes, pixels, _, bounds = _scratch()
    S, product = np.empty((3, 3, 3)), np.empty(16)
    W = _products_of_shapes(T)
    for i in range(len(order)):
        e = _U(order[i])
        if i + AHEAD < len(order):
            _fetch_three(gx, gx, gy, f_width, _U(order[i + AHEAD]), -fx0, -fy0, first_row, row_ptr, starts, stops)
        S[:] = 0.0
        linear = True
        for a in range(4):
            linear = linear and T[kinds[e], a, 3] == 0.0
        row, last_row, x, y = _U(row_ptr[e]), _U(row_ptr[e + _1]), FROM_START, first_row[e]
        x0, y0 = (starts[row], y) if row < last_row else (np.int32(0), y)
        while row < last_row:
            n_segments, n, row, x, y = _take_batch(row, last_row, x, y, x0, y0, starts, stops, gx, gx, gy, f_width,
                                                   fx0, fy0, pixels, bounds)
            if n_segments == 0:
                continue
            _local_coordinates(X, e, x0, y0, n, pixels, lanes)
            _weigh(n, n_segments, bounds, f_usable, fx0, fy0, lanes)
            if linear:
                _add_linear_products(n, pixels, lanes, S)
            else:
                for component in range(3):
                    _add_products(n, component, pixels, lanes, S)
        _transform(S, W[kinds[e]], e, product, out)
