"""The right-hand side's pixel pass in C, compiled where it runs."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.support.runs import DATA
from ddic.functionals.correlation import Correlation
from ddic.images.spline import SplineImage

SOURCE = Path(__file__).with_name("rhs_kernel.c")
FLAGS = ["-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math"]
"""Without the last two, gcc would neither take roots nor round a whole vector at once."""

PRECISIONS = {"float64": ["-DREAL=double", "-DINTEGER=int64_t", "-DSQRT=sqrt"],
              "float32": ["-DREAL=float", "-DINTEGER=int32_t", "-DSQRT=sqrtf"]}
"""Definitions by what positions, interpolation and sums are computed in; ddic's are float64."""

TOLERANCES = {"float64": 1e-11, "float32": 2e-6}
"""Difference from ddic's sums relative to the largest one that is rounding. float32 rounds to 6e-8, and
what some dozen operations on a pixel leave of that was measured: 2e-7."""

Sums = tuple[NDArray[np.float64], NDArray[np.float64]]


class _Image(ctypes.Structure):
    """``image`` of the source."""

    _fields_ = (("values", ctypes.c_void_p), ("stride", ctypes.c_int64), ("x0", ctypes.c_int64),
                ("y0", ctypes.c_int64), ("n", ctypes.c_int64))


class _Cells(ctypes.Structure):
    """``cell_list`` of the source."""

    _fields_ = (("n_visited", ctypes.c_int64),
                *((name, ctypes.c_void_p) for name in ("order", "X", "U", "first_row", "row_ptr", "starts", "stops")))


def compiled(precision: str) -> ctypes.CDLL:
    """The library of one of PRECISIONS; raises RuntimeError where gcc fails."""
    DATA.mkdir(parents=True, exist_ok=True)
    library = DATA / f"rhs_kernel_{precision}.so"
    done = subprocess.run(["gcc", *FLAGS, *PRECISIONS[precision], "-shared", "-fPIC", "-o", str(library), str(SOURCE),
                           "-lm"], text=True, capture_output=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"gcc: {done.stderr[-2000:]}")
    return ctypes.CDLL(str(library))


def right_hand_side(library: ctypes.CDLL, part: Correlation, spline: SplineImage,
                    u: NDArray[np.float64]) -> Callable[[], Sums]:
    """A call that makes moments (n_cells, 2, 4) of the residual and grey sums (n_cells, 6) of a part.

    u: (n_cells, 2, 4), displacement on the monomials, pixels.
    """
    r, geometry = part.raster, part.interpolation.geometry
    # The kernel takes float32 alone, and steps through values and slopes alike.
    values = np.ascontiguousarray(part.reference.values, dtype=np.float32)
    f = replace(part.reference, values=values, slopes=np.ascontiguousarray(part.reference.slopes))
    of_cells: list[NDArray[Any]] = [part.order, geometry, u, r.first_rows[:, 0], r.row_ptr, r.starts, r.stops]
    assert all(a.flags.c_contiguous for a in of_cells)
    cells = _Cells(len(part.order), *(a.ctypes.data for a in of_cells))
    reference = _image(values, f.window.x0, f.window.y0)
    # A pixel's place is that of its first tap, one pixel to the left of it and above.
    taps = _image(spline.coefficients, spline.window.x0 - 1, spline.window.y0 - 1)
    held = (of_cells, values, f, spline)

    def run() -> Sums:
        assert held
        moments, sums = np.empty((len(geometry), 2, 4)), np.empty((len(geometry), 6))
        library.right_hand_side(
            ctypes.byref(cells), ctypes.byref(reference), *(ctypes.c_void_p(by.ctypes.data) for by in f.slopes),
            ctypes.byref(taps), ctypes.c_void_p(moments.ctypes.data),
            ctypes.c_void_p(sums.ctypes.data))
        return moments, sums

    return run


def _image(values: NDArray[np.float32], x0: int, y0: int) -> _Image:
    """An image, or a part of one, as C takes it."""
    height, width = values.shape
    stride = values.strides[0] // values.itemsize
    return _Image(values.ctypes.data, stride, x0, y0, (height - 1) * stride + width)


def triad(library: ctypes.CDLL, n: int = 4_000_000) -> Callable[[], None]:
    """A call of STREAM's triad on three arrays of n numbers: 24 n bytes are read or written."""
    a, b, c = np.zeros(n), np.ones(n), np.ones(n)

    def run() -> None:
        library.triad(ctypes.c_int64(n), ctypes.c_double(3.0), ctypes.c_void_p(b.ctypes.data),
                      ctypes.c_void_p(c.ctypes.data), ctypes.c_void_p(a.ctypes.data))

    return run
