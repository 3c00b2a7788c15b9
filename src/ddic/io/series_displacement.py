"""Displacements of all frames of a series, read straight from its file."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.io import result_schema as schema
from ddic.io.result_reader import opened_result
from ddic.io.series_reader import SeriesResult

Array = NDArray[np.float64]

ROWS = 1 << 18
"""Nodes that are read at a time; a larger value takes more memory."""


def find_displacement_range(series: SeriesResult) -> tuple[Array, Array]:
    """Find the least and the largest displacement of a series; nodes that were not measured do not count.

    Parameters
    ----------
    series : SeriesResult
        Of at least one frame.

    Returns
    -------
    low, high : (2,) array
        Pixels, y down; nan where no node was measured.
    """
    low, high = np.full(2, np.nan), np.full(2, np.nan)
    with opened_result(series.path) as (_, file):
        stored = file[schema.POINT_DATA][schema.DISPLACEMENT]
        for begin in range(0, len(stored), ROWS):
            displacement = stored[begin:begin + ROWS, :2]
            low = np.fmin(low, np.fmin.reduce(displacement))
            high = np.fmax(high, np.fmax.reduce(displacement))
        if str(file.attrs["y_axis"]) == "up":
            low[1], high[1] = -high[1], -low[1]
    return low, high
