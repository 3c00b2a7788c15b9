"""A small image pair for tests of the Python interface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import ddic

SIZE = (160, 140)
WITHIN = 0.04
"""Pixels: twice the largest error that noise of one grey level leaves on elements of 20 px, where all pixels count."""
REGULARIZED = {"regularization": {"cut_off_wavelength": 80}}
TIGHT = {"tolerance": 1e-13, "rms_tolerance": 1e-11}
"""Gauss-Newton's tolerances by which methods may be compared to 1e-9 px."""


def move(points: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y = points.T
    return np.column_stack([0.4 + 0.004 * (x - 80), -0.3 - 0.002 * (y - 70)])


def largest_error(result: ddic.Result) -> float:
    return float(np.abs(result.displacement - move(result.mesh.nodes)).max())
