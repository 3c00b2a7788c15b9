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
    """

    cell: float
    pixel: float
    searched: float


AT_START, AT_END = Limits(0.8, 1.0, 0.8), Limits(0.6, 0.5, 0.15)
"""Where the field is a start, and where it is found. Real images of coarse meshes leave 0.46 px
in a cell of little texture at the edge of a hole, and less than 0.3 px elsewhere."""

NO_LIMITS = Limits(np.inf, np.inf, np.inf)
"""Where any residual is believed."""
