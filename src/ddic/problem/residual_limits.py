"""Displacement errors whose residual is believed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Limits:
    """From which displacement error on a residual is not believed.

    Attributes
    ----------
    cell : float
        Of a whole cell, pixels.
    pixel : float
        About a pixel, pixels.
    searched : float
        Of a cell from which on single pixels of it are looked at, pixels.
    beside : float
        Distance up to which a cell that is seen beside where it is put counts nevertheless, pixels.
    """

    cell: float
    pixel: float
    searched: float
    beside: float


CAPTURED = 1.5
"""Distance up to which grey levels say the way to where a cell is seen, pixels: some third of a speckle."""

AT_START, AT_END = Limits(0.8, 1.0, 0.8, CAPTURED), Limits(0.6, 0.5, 0.15, np.inf)
"""Where the field is a start, and where it is found, which mechanics may hold off by any distance. Real images of
coarse meshes leave 0.46 px in a cell of little texture at the edge of a hole, and less than 0.3 px elsewhere."""

NO_LIMITS = Limits(np.inf, np.inf, np.inf, np.inf)
"""Where any residual is believed."""
