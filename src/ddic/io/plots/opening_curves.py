"""Opening of discontinuities along them."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ddic.io.plots.length_unit import PIXELS, LengthUnit

Array = NDArray[np.float64]

OPENING_STYLES = ("-", "--", "-.", ":")


def draw_opening(curves: Mapping[str, tuple[Array, Array, Array]], unit: LengthUnit = PIXELS) -> Figure:
    """Draw slip and opening against the place along the line.

    Parameters
    ----------
    curves : dict of three (n,) arrays
        Label of a line -> distance along it, tangential and normal opening.
    unit : LengthUnit, optional
        Of all of them.

    Returns
    -------
    Figure
        The page.
    """
    figure = Figure(figsize=(7.0, 4.5), layout="tight")
    axes = figure.add_subplot()
    for style, (label, (distance, tangential, normal)) in zip(cycle(OPENING_STYLES), curves.items(), strict=False):
        prefix = "" if len(curves) == 1 else f"{label}, "
        axes.plot(distance, normal, style, color="tab:blue", linewidth=1.4, label=f"{prefix}normal")
        axes.plot(distance, tangential, style, color="tab:orange", linewidth=1.4, label=f"{prefix}tangential")
    axes.set_xlabel(f"distance along the line [{unit.name}]")
    axes.set_ylabel(f"opening [{unit.name}]")
    axes.set_title("Opening of discontinuities")
    axes.grid(alpha=0.25)
    axes.legend(fontsize="small")
    return figure
