"""Compiled loops over the pixels of cells, fused with the assembly of cell sums.

All loops go cell by cell and row by row. Within a row, pixels whose deformed position has the same
integer offset form a run, over which spline coefficients are read contiguously. Positions are
float64 and local to the cell; images are float32; sums are float64.
"""
# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import numba
import numpy as np

CHUNK = 256
FAST = {"contract", "reassoc", "nsz", "arcp"}

N_SUMS = 6
"""Sums over usable pixels of (1, r, g, r^2, g^2, r g) with r = f - g(x + u)."""


@numba.njit(cache=True, fastmath=FAST, inline="always")
def _local_coordinates(X, x0, y, n, xi, eta):
    """Invert x = X phi(xi, eta) along the row y for the n pixels x0, x0 + 1, ... (stable quadratic)."""
    e0, e1, f0, f1, g0, g1 = X[0, 1], X[1, 1], X[0, 2], X[1, 2], X[0, 3], X[1, 3]
    a = g0 * f1 - g1 * f0
    ef = e0 * f1 - e1 * f0
    h1 = y - X[1, 0]
    for k in range(n):
        h0 = x0 + k - X[0, 0]
        b = ef + h0 * g1 - h1 * g0
        c = h0 * e1 - h1 * e0
        t = 2.0 * c / (-b - np.sqrt(max(b * b - 4.0 * a * c, 0.0)))
        p0, p1 = e0 + g0 * t, e1 + g1 * t
        xi[k] = ((h0 - f0 * t) * p0 + (h1 - f1 * t) * p1) / (p0 * p0 + p1 * p1)
        eta[k] = t


@numba.njit(cache=True, fastmath=FAST, inline="always")
def _cubic_run(c, row, col, n, tx, ty, out):
    """Evaluate the cubic spline at n points; taps of point k start at c[row, col + k]."""
    r0, r1, r2, r3 = c[row], c[row + 1], c[row + 2], c[row + 3]
    for k in range(n):
        t, s = tx[k], ty[k]
        u, v = 1.0 - t, 1.0 - s
        wx0, wx3 = u * u * u, t * t * t
        wx1, wx2 = 4.0 - 3.0 * t * t * (1.0 + u), 4.0 - 3.0 * u * u * (1.0 + t)
        wy0, wy3 = v * v * v, s * s * s
        wy1, wy2 = 4.0 - 3.0 * s * s * (1.0 + v), 4.0 - 3.0 * v * v * (1.0 + s)
        j = col + k
        a0 = wx0 * r0[j] + wx1 * r0[j + 1] + wx2 * r0[j + 2] + wx3 * r0[j + 3]
        a1 = wx0 * r1[j] + wx1 * r1[j + 1] + wx2 * r1[j + 2] + wx3 * r1[j + 3]
        a2 = wx0 * r2[j] + wx1 * r2[j + 1] + wx2 * r2[j + 2] + wx3 * r2[j + 3]
        a3 = wx0 * r3[j] + wx1 * r3[j + 1] + wx2 * r3[j + 2] + wx3 * r3[j + 3]
        out[k] = (wy0 * a0 + wy1 * a1 + wy2 * a2 + wy3 * a3) * (1.0 / 36.0)


@numba.njit(cache=True, fastmath=FAST, inline="always")
def _quintic_weights(t):
    u = 1.0 - t
    t2, u2 = t * t, u * u
    w0, w5 = u2 * u2 * u, t2 * t2 * t
    w1 = 26.0 + t * (-50.0 + t * (20.0 + t * (20.0 + t * (-20.0 + 5.0 * t))))
    w4 = 26.0 + u * (-50.0 + u * (20.0 + u * (20.0 + u * (-20.0 + 5.0 * u))))
    w2 = 66.0 + t2 * (-60.0 + t2 * (30.0 - 10.0 * t))
    w3 = 66.0 + u2 * (-60.0 + u2 * (30.0 - 10.0 * u))
    return w0, w1, w2, w3, w4, w5


@numba.njit(cache=True, fastmath=FAST, inline="always")
def _quintic_run(c, row, col, n, tx, ty, out):
    """Evaluate the quintic spline at n points; taps of point k start at c[row, col + k]."""
    for k in range(n):
        w0, w1, w2, w3, w4, w5 = _quintic_weights(tx[k])
        wy = _quintic_weights(ty[k])
        j = col + k
        value = 0.0
        for i in range(6):
            r = c[row + i]
            value += wy[i] * (w0 * r[j] + w1 * r[j + 1] + w2 * r[j + 2]
                              + w3 * r[j + 3] + w4 * r[j + 4] + w5 * r[j + 5])
        out[k] = value * (1.0 / 14400.0)


@numba.njit(cache=True, fastmath=FAST, inline="always")
def _deformed_values(U, x0, y, n, xi, eta, spline, degree, origin_x, origin_y, width, height,
                     g_usable, ix, iy, tx, ty, weight, g):
    """Evaluate g at x + u(x) for n pixels of a row; weight is 0 where x + u leaves the image or is masked.

    origin_x, origin_y: the spline window's first pixel; width, height: the whole image's size.
    """
    pad = degree // 2 + 1
    for k in range(n):
        p = xi[k] * eta[k]
        px = x0 + k + U[0, 0] + U[0, 1] * xi[k] + U[0, 2] * eta[k] + U[0, 3] * p
        py = y + U[1, 0] + U[1, 1] * xi[k] + U[1, 2] * eta[k] + U[1, 3] * p
        inside = (px >= 0.0) & (px <= width - 1.0) & (py >= 0.0) & (py <= height - 1.0)
        weight[k] = 1.0 if inside else 0.0
        px = min(max(px, 0.0), width - 1.0)
        py = min(max(py, 0.0), height - 1.0)
        fx, fy = np.floor(px), np.floor(py)
        ix[k], iy[k] = np.int32(fx) - origin_x, np.int32(fy) - origin_y
        tx[k], ty[k] = px - fx, py - fy
    if g_usable.size > 0:
        for k in range(n):
            weight[k] *= g_usable[iy[k], ix[k]]
    begin = 0
    shift = pad - degree // 2
    while begin < n:
        end = begin + 1
        while end < n and iy[end] == iy[begin] and ix[end] - ix[begin] == end - begin:
            end += 1
        if degree == 3:
            _cubic_run(spline, iy[begin] + shift, ix[begin] + shift, end - begin,
                       tx[begin:end], ty[begin:end], g[begin:end])
        else:
            _quintic_run(spline, iy[begin] + shift, ix[begin] + shift, end - begin,
                         tx[begin:end], ty[begin:end], g[begin:end])
        begin = end


@numba.njit(cache=True, fastmath=FAST, nogil=True)
def residual_sums(X, U, first_row, row_ptr, starts, stops,
                  f, gx, gy, f_usable, fx0, fy0,
                  spline, degree, origin_x, origin_y, width, height, g_usable, all_kinds,
                  moments, sums):
    """Accumulate, per cell, moments of the residual against grad f and the monomials, and plain sums.

    X, U: (n_cells, 2, 4) geometry and displacement coefficients on the monomials.
    moments: (n_cells, 3, 2, 4), sums of (r, g, 1) x (f_x, f_y) x (1, xi, eta, xi eta); the last two
    kinds only where all_kinds. sums: (n_cells, N_SUMS).
    """
    xi, eta = np.empty(CHUNK), np.empty(CHUNK)
    tx, ty, weight, g = np.empty(CHUNK), np.empty(CHUNK), np.empty(CHUNK), np.empty(CHUNK)
    ix, iy = np.empty(CHUNK, np.int32), np.empty(CHUNK, np.int32)
    for e in range(len(first_row)):
        m00 = m01 = m02 = m03 = m10 = m11 = m12 = m13 = 0.0
        s0 = s1 = s2 = s3 = s4 = s5 = 0.0
        for row in range(row_ptr[e], row_ptr[e + 1]):
            y = first_row[e] + row - row_ptr[e]
            for x0 in range(starts[row], stops[row], CHUNK):
                n = min(CHUNK, stops[row] - x0)
                _local_coordinates(X[e], x0, y, n, xi, eta)
                _deformed_values(U[e], x0, y, n, xi, eta, spline, degree, origin_x, origin_y,
                                 width, height, g_usable, ix, iy, tx, ty, weight, g)
                if f_usable.size > 0:
                    for k in range(n):
                        weight[k] *= f_usable[y - fy0, x0 - fx0 + k]
                f_row = f[y - fy0, x0 - fx0: x0 - fx0 + n]
                gx_row = gx[y - fy0, x0 - fx0: x0 - fx0 + n]
                gy_row = gy[y - fy0, x0 - fx0: x0 - fx0 + n]
                for k in range(n):
                    w, value = weight[k], g[k]
                    r = w * (f_row[k] - value)
                    value *= w
                    a, b = r * gx_row[k], r * gy_row[k]
                    t, s = xi[k], eta[k]
                    m00 += a
                    m01 += a * t
                    m02 += a * s
                    m03 += a * t * s
                    m10 += b
                    m11 += b * t
                    m12 += b * s
                    m13 += b * t * s
                    s0 += w
                    s1 += r
                    s2 += value
                    s3 += r * r
                    s4 += value * value
                    s5 += r * value
                if all_kinds:
                    for k in range(n):
                        for c in range(2):
                            slope = weight[k] * (gx_row[k] if c == 0 else gy_row[k])
                            t, s = xi[k], eta[k]
                            for kind in range(1, 3):
                                a = slope * g[k] if kind == 1 else slope
                                moments[e, kind, c, 0] += a
                                moments[e, kind, c, 1] += a * t
                                moments[e, kind, c, 2] += a * s
                                moments[e, kind, c, 3] += a * t * s
        m = moments[e, 0]
        m[0, 0], m[0, 1], m[0, 2], m[0, 3] = m00, m01, m02, m03
        m[1, 0], m[1, 1], m[1, 2], m[1, 3] = m10, m11, m12, m13
        q = sums[e]
        q[0], q[1], q[2], q[3], q[4], q[5] = s0, s1, s2, s3, s4, s5


@numba.njit(cache=True, fastmath=FAST, nogil=True)
def residual_pixels(X, U, first_row, row_ptr, starts, stops, f, f_usable, fx0, fy0,
                    spline, degree, origin_x, origin_y, width, height, g_usable, gain, offset, out):
    """Write f - gain g(x + u) - offset into out (the reference window's shape), NaN where a pixel is left out.

    gain, offset: (n_cells,).
    """
    xi, eta = np.empty(CHUNK), np.empty(CHUNK)
    tx, ty, weight, g = np.empty(CHUNK), np.empty(CHUNK), np.empty(CHUNK), np.empty(CHUNK)
    ix, iy = np.empty(CHUNK, np.int32), np.empty(CHUNK, np.int32)
    for e in range(len(first_row)):
        for row in range(row_ptr[e], row_ptr[e + 1]):
            y = first_row[e] + row - row_ptr[e]
            for x0 in range(starts[row], stops[row], CHUNK):
                n = min(CHUNK, stops[row] - x0)
                _local_coordinates(X[e], x0, y, n, xi, eta)
                _deformed_values(U[e], x0, y, n, xi, eta, spline, degree, origin_x, origin_y,
                                 width, height, g_usable, ix, iy, tx, ty, weight, g)
                for k in range(n):
                    i, j = y - fy0, x0 - fx0 + k
                    used = weight[k] > 0.0 and (f_usable.size == 0 or f_usable[i, j] > 0)
                    out[i, j] = f[i, j] - gain[e] * g[k] - offset[e] if used else np.nan


@numba.njit(cache=True, fastmath=FAST, nogil=True)
def hessian_cells(X, T, first_row, row_ptr, starts, stops, gx, gy, f_usable, fx0, fy0, out):
    """Assemble M_e = sum_px N_a N_b grad f grad f^T of every cell into out (n_cells, 4, 2, 4, 2), Eq. 5 of [BP17].

    X: (n_cells, 2, 4) geometry; T: (n_cells, 4, 4) shape coefficients on the monomials.
    """
    xi, eta = np.empty(CHUNK), np.empty(CHUNK)
    S = np.empty((3, 3, 3))
    half = np.empty((4, 4))
    for e in range(len(first_row)):
        S[:] = 0.0
        for row in range(row_ptr[e], row_ptr[e + 1]):
            y = first_row[e] + row - row_ptr[e]
            for x0 in range(starts[row], stops[row], CHUNK):
                n = min(CHUNK, stops[row] - x0)
                _local_coordinates(X[e], x0, y, n, xi, eta)
                if f_usable.size > 0:
                    _add_hessian_masked(S, n, xi, eta, gx[y - fy0, x0 - fx0:], gy[y - fy0, x0 - fx0:],
                                        f_usable[y - fy0, x0 - fx0:])
                else:
                    _add_hessian(S, n, xi, eta, gx[y - fy0, x0 - fx0:], gy[y - fy0, x0 - fx0:])
        for component in range(3):
            c, d = (0, 0) if component == 0 else ((0, 1) if component == 1 else (1, 1))
            for a in range(4):
                for n in range(4):
                    half[a, n] = 0.0
                    for m in range(4):
                        half[a, n] += T[e, a, m] * S[component, m % 2 + n % 2, m // 2 + n // 2]
            for a in range(4):
                for b in range(4):
                    value = 0.0
                    for n in range(4):
                        value += half[a, n] * T[e, b, n]
                    out[e, a, c, b, d] = value
                    out[e, b, d, a, c] = value


@numba.njit(cache=True, fastmath=FAST, inline="always")
def _add_hessian(S, n, xi, eta, gx, gy):
    for component in range(3):
        a00 = a10 = a20 = a01 = a11 = a21 = a02 = a12 = a22 = 0.0
        for k in range(n):
            u, v = 1.0 * gx[k], 1.0 * gy[k]  # in float64: the product of two float32 numbers would be rounded
            w = u * u if component == 0 else (u * v if component == 1 else v * v)
            t, s = xi[k], eta[k]
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
        p = S[component]
        p[0, 0] += a00
        p[1, 0] += a10
        p[2, 0] += a20
        p[0, 1] += a01
        p[1, 1] += a11
        p[2, 1] += a21
        p[0, 2] += a02
        p[1, 2] += a12
        p[2, 2] += a22


@numba.njit(cache=True, fastmath=FAST, inline="always")
def _add_hessian_masked(S, n, xi, eta, gx, gy, usable):
    for k in range(n):
        if usable[k] > 0:
            _add_hessian(S, 1, xi[k: k + 1], eta[k: k + 1], gx[k: k + 1], gy[k: k + 1])
