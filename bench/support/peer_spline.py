"""A compiled cubic B-spline in place of pyxel's interpolation; runs in the peers' environment."""
# mypy: disable-error-code="untyped-decorator"

from __future__ import annotations

import numpy as np
import pyxel
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import spline_filter

Values = NDArray[np.float64]


def replace_interpolation() -> None:
    """Give every pyxel image the compiled spline; all else of pyxel stays as it is."""
    pyxel.Image.BuildInterp = build
    pyxel.Image.Interp = interpolate
    pyxel.Image.InterpGrad = interpolate_gradient


def build(image: pyxel.Image) -> None:
    """Spline coefficients of the whole image, as scipy.ndimage.map_coordinates filters them."""
    # pyxel takes the attribute ``tck`` as the sign that this was done.
    image.tck = spline_filter(np.asarray(image.pix, np.float64), order=3, mode="mirror")


def interpolate(image: pyxel.Image, u: Values, v: Values) -> Values:
    """Grey levels at columns u and rows v, (n,) pixels."""
    if not hasattr(image, "tck"):
        image.BuildInterp()
    found = np.empty(len(u))
    evaluate(image.tck, v - image.v0, u - image.u0, found)
    return found


def interpolate_gradient(image: pyxel.Image, u: Values, v: Values) -> tuple[Values, Values]:
    """Derivatives of the grey level by column and by row at (n,) points, grey levels a pixel."""
    by_column, by_row = np.empty(len(u)), np.empty(len(u))
    evaluate_gradient(image.tck, v - image.v0, u - image.u0, by_column, by_row)
    return by_column, by_row


@njit(cache=True, inline="always")
def weights(t: float) -> tuple[float, float, float, float]:
    """Cubic B-splines of four neighbours, t from the second."""
    s = 1.0 - t
    return (s * s * s / 6.0, (4.0 + t * t * (3.0 * t - 6.0)) / 6.0, (4.0 + s * s * (3.0 * s - 6.0)) / 6.0,
            t * t * t / 6.0)


@njit(cache=True, inline="always")
def slopes(t: float) -> tuple[float, float, float, float]:
    """Derivatives of ``weights``."""
    s = 1.0 - t
    return -0.5 * s * s, t * (1.5 * t - 2.0), -s * (1.5 * s - 2.0), 0.5 * t * t


@njit(cache=True)
def evaluate(coefficients: Values, rows: Values, columns: Values, found: Values) -> None:
    """The spline at points whose four neighbours lie inside the image both ways."""
    for k in range(len(rows)):
        i, j = int(np.floor(rows[k])), int(np.floor(columns[k]))
        a = weights(rows[k] - i)
        b = weights(columns[k] - j)
        total = 0.0
        for m in range(4):
            line = coefficients[i + m - 1]
            total += a[m] * (b[0] * line[j - 1] + b[1] * line[j] + b[2] * line[j + 1] + b[3] * line[j + 2])
        found[k] = total


@njit(cache=True)
def evaluate_gradient(coefficients: Values, rows: Values, columns: Values, by_column: Values,
                      by_row: Values) -> None:
    """The spline's gradient at points whose four neighbours lie inside the image both ways."""
    for k in range(len(rows)):
        i, j = int(np.floor(rows[k])), int(np.floor(columns[k]))
        t, s = rows[k] - i, columns[k] - j
        a, da = weights(t), slopes(t)
        b, db = weights(s), slopes(s)
        along, across = 0.0, 0.0
        for m in range(4):
            line = coefficients[i + m - 1]
            along += a[m] * (db[0] * line[j - 1] + db[1] * line[j] + db[2] * line[j + 1] + db[3] * line[j + 2])
            across += da[m] * (b[0] * line[j - 1] + b[1] * line[j] + b[2] * line[j + 1] + b[3] * line[j + 2])
        by_column[k], by_row[k] = along, across
