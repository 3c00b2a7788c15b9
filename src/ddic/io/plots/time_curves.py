"""What the frames of a series come to, against time."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, ScalarFormatter
from numpy.typing import NDArray

from ddic.io.plots.failure_mark import FAILURE_COLOUR
from ddic.io.plots.length_unit import PIXELS, LengthUnit
from ddic.io.plots.page_text import format_title
from ddic.io.series_history import SeriesHistory

Array = NDArray[np.float64]

PAGE_INCHES = (7.0, 9.6)
BLUE, ORANGE = "tab:blue", "tab:orange"

MOST_MARKERS = 60
"""Frames up to which markers are large; a larger value makes curves of long series thick."""

TITLE_POINTS = 11.0

SHARE_ABOVE = 1.15
"""Height of panels that begin at 0, relative to their largest value."""


def draw_time_curves(history: SeriesHistory, name: str, unit: LengthUnit = PIXELS) -> Figure:
    """Draw displacement, strain, residual, noise floor and iterations against time, a panel each.

    Parameters
    ----------
    history : SeriesHistory
        Of the frames; those that were not measured are marked.
    name : str
        Of the series.
    unit : LengthUnit, optional
        Of displacements.

    Returns
    -------
    Figure
        The page.
    """
    figure = Figure(figsize=PAGE_INCHES, layout="tight")
    panels = figure.subplots(5, 1, sharex=True)
    _draw_displacement(panels[0], history, unit)
    _draw_strain(panels[1], history)
    for axes, values, label in zip(panels[2:], (history.residual, unit.size * history.noise_floor, history.iterations),
                                   ("residual\n[grey levels]", f"noise floor\n[{unit.name}]", "iterations"),
                                   strict=True):
        _draw_curve(axes, history, values, BLUE, "")
        axes.set_ylabel(label)
        # From 0, so that rounding of what stays does not look like a change.
        axes.set_ylim(0, SHARE_ABOVE * float(np.nanmax(values, initial=1e-300)))
    for axes in panels:
        _set_up_panel(axes, history)
    figure.align_ylabels(panels)
    panels[4].yaxis.set_major_locator(MaxNLocator(nbins=5, integer=True))
    panels[4].set_xlabel("time")
    if np.all(history.times == np.round(history.times)):
        panels[4].xaxis.set_major_locator(MaxNLocator(nbins=10, integer=True))
    figure.suptitle(_write_title(history, name), fontsize=TITLE_POINTS)
    return figure


def _set_up_panel(axes: Axes, history: SeriesHistory) -> None:
    """Marks of frames that were not measured, a grid, numbers, and the legend where there are several curves."""
    n_curves = len(axes.get_legend_handles_labels()[1])
    _mark_failures(axes, history)
    axes.grid(alpha=0.25)
    numbers = ScalarFormatter(useMathText=True)
    numbers.set_powerlimits((-2, 4))
    axes.yaxis.set_major_formatter(numbers)
    if n_curves:
        axes.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.01, 0.5), borderaxespad=0.0)


def _write_title(history: SeriesHistory, name: str) -> str:
    n_frames, n_failed = len(history.times), int((~history.is_measured).sum())
    failed = f", {n_failed} of them not measured" if n_failed else ""
    return format_title(f"{name}: {n_frames} frames{failed}", PAGE_INCHES[0] - 0.4, TITLE_POINTS)


def _draw_displacement(axes: Axes, history: SeriesHistory, unit: LengthUnit) -> None:
    """RMS of both components, and between which values they lie."""
    for component, (colour, symbol) in enumerate(((BLUE, "u_x"), (ORANGE, "u_y"))):
        low, high = unit.size * history.lowest[:, component], unit.size * history.highest[:, component]
        axes.fill_between(history.times, low, high, color=colour, alpha=0.18, linewidth=0,
                          label=f"${symbol}$, least to largest")
        for edge in (low, high):
            axes.plot(history.times, edge, color=colour, linewidth=0.7)
        _draw_curve(axes, history, unit.size * history.rms[:, component], colour, f"${symbol}$, RMS")
    axes.margins(y=0.12)
    axes.set_ylabel(f"displacement\n[{unit.name}]")


def _draw_strain(axes: Axes, history: SeriesHistory) -> None:
    for k, colour in enumerate((BLUE, ORANGE)):
        _draw_curve(axes, history, history.principal_strains[:, k], colour, rf"$\varepsilon_{k + 1}$, mean")
    axes.margins(y=0.12)
    axes.set_ylabel("principal strain\n[-]")


def _draw_curve(axes: Axes, history: SeriesHistory, values: Array, colour: str, label: str) -> None:
    """Values of each frame; the curve is broken where one was not measured."""
    size = 3.5 if len(history.times) <= MOST_MARKERS else 1.5
    axes.plot(history.times, values, "o-", markersize=size, color=colour, linewidth=1.4, label=label or None)


def _mark_failures(axes: Axes, history: SeriesHistory) -> None:
    for number, time in enumerate(history.times[~history.is_measured]):
        axes.axvline(time, color=FAILURE_COLOUR, linestyle="--", linewidth=1.0,
                     label="not measured" if number == 0 else None)
