"""Maps of a component of several fields beside each other, in the same colours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ddic.plots.canvas import COLOURS

Array = NDArray[np.float64]

PERCENTILE = 99.5
"""Of the values of a row at which the colours end: single pixels do not hide the rest. A larger value pales the map."""

PANEL_INCHES = 2.7
"""Side of a map with its title."""


@dataclass(frozen=True, eq=False)
class MapRow:
    """Maps that share their colours, with those of other rows of the same label too.

    Attributes
    ----------
    label : str
        Of the colour bar, with the unit.
    maps : mapping of (n_rows, n_columns) array
        By title.
    signed : bool
        Whether colours are the same on both sides of zero.
    """

    label: str
    maps: Mapping[str, Array]
    signed: bool = True


def find_limits(rows: Sequence[MapRow]) -> tuple[float, float]:
    """Find the least and the largest value that has a colour of its own in rows of one label."""
    values = np.concatenate([one[np.isfinite(one)] for row in rows for one in row.maps.values()])
    if rows[0].signed:
        largest = float(np.percentile(np.abs(values), PERCENTILE))
        return -largest, largest
    low, high = np.percentile(values, [100.0 - PERCENTILE, PERCENTILE])
    return float(low), float(high)


def draw_maps(rows: Sequence[MapRow], region: tuple[float, float, float, float]) -> Figure:
    """Draw rows of maps of a region, x0, y0, x1, y1, pixels, in image coordinates; short rows begin farther right."""
    n_columns = max(len(row.maps) for row in rows)
    figure = Figure(figsize=(PANEL_INCHES * n_columns + 0.8, PANEL_INCHES * len(rows)), layout="constrained")
    panels = figure.subplots(len(rows), n_columns, squeeze=False)
    for row, of_row in zip(rows, panels, strict=True):
        low, high = find_limits([other for other in rows if other.label == row.label])
        n_empty = n_columns - len(row.maps)
        for axes in of_row[:n_empty]:
            axes.set_axis_off()
        for axes, (title, values) in zip(of_row[n_empty:], row.maps.items(), strict=True):
            drawn = axes.imshow(values, cmap="RdBu_r" if row.signed else COLOURS, vmin=low, vmax=high,
                                extent=(region[0], region[2], region[3], region[1]), interpolation="nearest")
            axes.set_title(title, fontsize="small")
            axes.tick_params(labelsize="x-small")
        bar = figure.colorbar(drawn, ax=list(of_row), shrink=0.85, extend="both")
        bar.set_label(row.label, fontsize="small")
        bar.ax.tick_params(labelsize="x-small")
    # Once for each row and column.
    for of_row in panels:
        next(axes for axes in of_row if axes.axison).set_ylabel("y [px]", fontsize="small")
    for of_column in panels[::-1].T:
        next(axes for axes in of_column if axes.axison).set_xlabel("x [px]", fontsize="small")
    return figure
