"""Compiled loops over rows of pixels: the integrals of Eq. (19) of [PP12], and the residual f - g(x + u).

Both components' integrals come from one sweep over the image, which then runs at the speed of the memory: a pixel
brings 12 bytes (f_x, f_y and the residual, float32), everything summed is float64. Slopes ``by_x`` and ``by_y``, f_x
and f_y in grey levels per pixel, and the residual r, grey levels, are (height, width) float32 in all of them.
"""
# mypy: disable-error-code="no-untyped-def, assignment"

import numba
import numpy as np

from ddic.functionals.pixel_kernels import FLAGS, INLINED

TILE = 512
"""Columns whose sums are kept in the first-level cache while rows pass."""

N_SUMS = 5
"""Sums of f_x^2 v^2, f_x f_y v w, f_y^2 w^2, r f_x v and r f_y w, (v, w) the functions of the other direction."""


N_GREY = 6
"""Sums of (1, r, g, r^2, g^2, r g), as ``GreySums`` has them."""


@numba.njit(**FLAGS)
def sum_over_rows(by_x, by_y, residual, functions, sums):
    """Add integrals over a band's rows to ``sums`` (5, width); ``functions`` (2, height) are v and w: Y in each."""
    height, width = residual.shape
    # One array for all five, a constant apart: the compiler then knows that they do not overlap.
    tile = np.empty(N_SUMS * TILE)
    for first in range(0, width, TILE):
        n = min(TILE, width - first)
        tile[:] = 0.0
        for j in range(height):
            v, w = functions[0, j], functions[1, j]
            vv, vw, ww = v * v, v * w, w * w
            of_x, of_y, of_r = by_x[j, first:first + n], by_y[j, first:first + n], residual[j, first:first + n]
            for i in range(n):
                a, b, r = np.float64(of_x[i]), np.float64(of_y[i]), np.float64(of_r[i])
                tile[i] += a * a * vv
                tile[TILE + i] += a * b * vw
                tile[2 * TILE + i] += b * b * ww
                tile[3 * TILE + i] += r * a * v
                tile[4 * TILE + i] += r * b * w
        for k in range(N_SUMS):
            for i in range(n):
                sums[k, first + i] += tile[k * TILE + i]


@numba.njit(**FLAGS)
def sum_over_columns(by_x, by_y, residual, functions, sums):
    """Set ``sums`` (5, height) to integrals over a band's columns; ``functions`` (2, width) are v and w: X in each."""
    height, width = residual.shape
    for j in range(height):
        s0, s1, s2, s3, s4 = 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(width):
            v = by_x[j, i] * functions[0, i]
            w = by_y[j, i] * functions[1, i]
            r = np.float64(residual[j, i])
            s0 += v * v
            s1 += v * w
            s2 += w * w
            s3 += r * v
            s4 += r * w
        sums[0, j], sums[1, j], sums[2, j], sums[3, j], sums[4, j] = s0, s1, s2, s3, s4


@numba.njit(**FLAGS)
def sum_blocks(by_x, by_y, residual, first_row, edges_y, edges_x, sums):
    """Add r f_x and r f_y over blocks of pixels to ``sums`` (2, n_y, n_x).

    ``first_row`` of the band, and ``edges_y`` and ``edges_x`` (n + 1,), where blocks begin, are counted from the
    rectangle's first row and column.
    """
    height = residual.shape[0]
    row = 0
    for j in range(height):
        while first_row + j >= edges_y[row + 1]:
            row += 1
        for column in range(len(edges_x) - 1):
            s, t = 0.0, 0.0
            for i in range(edges_x[column], edges_x[column + 1]):
                r = np.float64(residual[j, i])
                s += r * by_x[j, i]
                t += r * by_y[j, i]
            sums[0, row, column] += s
            sums[1, row, column] += t


@numba.njit(**INLINED)
def _cubic_weights(t):
    """Weights of the cubic B-spline's four taps at a fraction t of a pixel."""
    s = 1.0 - t
    return (s * s * s / 6.0, 2.0 / 3.0 - t * t * (2.0 - t) / 2.0, 2.0 / 3.0 - s * s * (2.0 - s) / 2.0,
            t * t * t / 6.0)


@numba.njit(**FLAGS)
def _quintic_weights(t, weights):
    """Set the six weights of the quintic B-spline at a fraction t of a pixel."""
    for k in range(6):
        # Distance from the tap, of a function that is even.
        d = abs(t + 2.0 - k)
        if d < 1.0:
            weights[k] = 0.55 - 0.5 * d**2 + 0.25 * d**4 - d**5 / 12.0
        elif d < 2.0:
            weights[k] = 0.425 + 0.625 * d - 1.75 * d**2 + 1.25 * d**3 - 0.375 * d**4 + d**5 / 24.0
        else:
            weights[k] = (3.0 - d) ** 5 / 120.0


@numba.njit(**INLINED)
def _evaluate_spline(spline, left, top, right_by, down_by, degree, wx, wy):
    """Evaluate the spline whose taps begin at [top, left], at fractions of a pixel; wx, wy (6,) are scratch."""
    g = 0.0
    if degree == 3:
        a, b, c, d = _cubic_weights(right_by)
        for k, weight in enumerate(_cubic_weights(down_by)):
            row = top + k
            g += weight * (a * spline[row, left] + b * spline[row, left + 1] + c * spline[row, left + 2]
                           + d * spline[row, left + 3])
        return g
    _quintic_weights(right_by, wx)
    _quintic_weights(down_by, wy)
    for a in range(6):
        s = 0.0
        for b in range(6):
            s += wx[b] * spline[top + a, left + b]
        g += wy[a] * s
    return g


@numba.njit(**FLAGS)
def fill_residual(values, ux, uy, x0, y0, spline, degree, spline_x0, spline_y0, usable, extent, residual, report):
    """Compute the residual f - g(x + u) of a block of pixels, grey levels; nan where a pixel does not count.

    ``values`` of f (float32, nan where a pixel is left out), the displacement ``ux`` and ``uy``, pixels, and
    ``residual``, which is overwritten, are (height, width) of the block, whose first column and row are ``x0`` and
    ``y0``. ``spline`` holds the padded coefficients, of degree 3 or 5, of a window of g, whose first column and row are
    ``spline_x0`` and ``spline_y0``, and ``usable`` (uint8) is of that window, as ``SplineImage`` has it; (0, 0) where
    nothing is excluded. ``extent`` is width and height of the image. To ``report`` (7,) are added the six sums of
    ``GreySums``, then the number of pixels displaced beyond the window.
    """
    height, width = values.shape
    pad = (degree + 1) // 2
    reach = degree // 2
    wx, wy = np.empty(6), np.empty(6)
    rows, columns = spline.shape
    n, sr, sg, srr, sgg, srg, missing = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(height):
        for i in range(width):
            residual[j, i] = np.nan
            f = np.float64(values[j, i])
            dx, dy = ux[j, i], uy[j, i]
            x, y = x0 + i + dx, y0 + j + dy
            if not (x >= 0.0 and x <= extent[0] - 1 and y >= 0.0 and y <= extent[1] - 1):
                continue
            whole_x, whole_y = np.floor(dx), np.floor(dy)
            column = x0 + i + np.int64(whole_x) - spline_x0
            row = y0 + j + np.int64(whole_y) - spline_y0
            if column < 0 or row < 0 or column >= columns - 2 * pad or row >= rows - 2 * pad:
                missing += 1.0
                continue
            if usable.size > 0 and not usable[row, column]:
                continue
            g = _evaluate_spline(spline, column - reach + pad, row - reach + pad, dx - whole_x,
                                dy - whole_y, degree, wx, wy)
            r = f - g
            residual[j, i] = r
            if np.isnan(r):
                continue
            n += 1.0
            sr += r
            sg += g
            srr += r * r
            sgg += g * g
            srg += r * g
    report[0] += n
    report[1] += sr
    report[2] += sg
    report[3] += srr
    report[4] += sgg
    report[5] += srg
    report[6] += missing
