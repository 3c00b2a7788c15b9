"""The right-hand side's pixel pass in C, compiled where it runs."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.support.runs import DATA
from ddic.functionals.correlation import Correlation
from ddic.images.spline import SplineImage

SOURCE = Path(__file__).with_name("rhs_kernel.c")
FLAGS = {
    "-O3 -march=native": ["-O3", "-march=native"],
    "-O3 -march=native, sums reordered": ["-O3", "-march=native", "-fassociative-math", "-fno-signed-zeros",
                                          "-fno-trapping-math", "-fno-math-errno"],
}
"""The second lets gcc make vectors of sums, as numba may."""

Sums = tuple[NDArray[np.float64], NDArray[np.float64]]


def compiled(flags: str) -> ctypes.CDLL:
    """The library compiled with flags of FLAGS; raises RuntimeError where gcc fails."""
    DATA.mkdir(parents=True, exist_ok=True)
    library = DATA / f"rhs_kernel_{list(FLAGS).index(flags)}.so"
    done = subprocess.run(["gcc", *FLAGS[flags], "-shared", "-fPIC", "-o", str(library), str(SOURCE), "-lm"],
                          text=True, capture_output=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"gcc: {done.stderr[-2000:]}")
    return ctypes.CDLL(str(library))


def right_hand_side(library: ctypes.CDLL, part: Correlation, spline: SplineImage,
                    u: NDArray[np.float64]) -> Callable[[], Sums]:
    """A call that makes moments (n_cells, 2, 4) of the residual and grey sums (n_cells, 6) of a part.

    u: (n_cells, 2, 4), displacement on the monomials, pixels.
    """
    f, r, geometry = part.reference, part.raster, part.interpolation.geometry
    arrays: list[NDArray[Any]] = [geometry, u, r.first_row, r.row_ptr, r.starts, r.stops, f.values, f.by_x, f.by_y,
                                 spline.coefficients]
    pointers: list[Any] = [ctypes.c_void_p(a.ctypes.data) for a in arrays]
    row_length = f.values.strides[0] // f.values.itemsize
    n_cells = len(geometry)

    def run() -> Sums:
        # The image may be a part of a larger one.
        assert all(a.flags.c_contiguous for a in arrays[:6])
        moments, sums = np.empty((n_cells, 2, 4)), np.empty((n_cells, 6))
        whole = ctypes.c_int64
        library.right_hand_side(
            whole(n_cells), *pointers[:9], whole(row_length), whole(f.window.x0), whole(f.window.y0), pointers[9],
            whole(spline.coefficients.shape[1]), whole(spline.window.x0), whole(spline.window.y0),
            ctypes.c_void_p(moments.ctypes.data), ctypes.c_void_p(sums.ctypes.data))
        return moments, sums

    return run


def triad(library: ctypes.CDLL, n: int = 4_000_000) -> Callable[[], None]:
    """A call of STREAM's triad on three arrays of n numbers: 24 n bytes are read or written."""
    a, b, c = np.zeros(n), np.ones(n), np.ones(n)

    def run() -> None:
        library.triad(ctypes.c_int64(n), ctypes.c_double(3.0), ctypes.c_void_p(b.ctypes.data),
                      ctypes.c_void_p(c.ctypes.data), ctypes.c_void_p(a.ctypes.data))

    return run
