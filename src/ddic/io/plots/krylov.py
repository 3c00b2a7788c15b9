"""Convergence curves of the Krylov iterations (Fig. 11 of [BP17])."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from ddic.io.plots.canvas import COLOURS

STYLES = (("-", "o"), ("--", "s"), ("-.", "^"), (":", "v"))
"""Lines and markers: a history of one value is a point."""

LONGEST_LABEL = 24
"""Characters of a label; a larger value makes the legend as wide as the page."""

MOST_NAMED = 12
"""Curves that are all named beside the axes; of more, every second or third is."""

LIGHTEST = 0.85
"""Place in the colours of the last iteration, 0 to 1; a larger value is lighter."""


def draw_krylov(curves: Mapping[str, Sequence[NDArray[np.float64]]]) -> Figure:
    """Draw the relative residual against the iteration.

    Each label has a line style; its Gauss-Newton iterations run through the colours.

    Parameters
    ----------
    curves : dict of sequence of (n,) array
        Label -> histories, one array for each Gauss-Newton iteration; an empty label for one result alone.

    Returns
    -------
    Figure
        The page.
    """
    figure = Figure(figsize=(7.0, 4.5), layout="tight")
    axes = figure.add_subplot()
    for (style, marker), (label, histories) in zip(cycle(STYLES), curves.items(), strict=False):
        shades = colormaps[COLOURS](np.linspace(0.0, LIGHTEST, len(histories)))
        for number, (history, shade) in enumerate(zip(histories, shades, strict=True), start=1):
            if len(history) == 0:
                continue
            # A history that ends at an exact zero has no logarithm: its last point is not drawn.
            shown = np.where(np.asarray(history) > 0, history, np.nan)
            name = f"Gauss-Newton {number}"
            axes.semilogy(np.arange(len(shown)), shown, style, color=shade, linewidth=1.4, marker=marker, markersize=4,
                          label=f"{_shorten(label)}, {name}" if label else name)
    axes.set_xlabel("Krylov iteration [-]")
    axes.set_ylabel("relative residual [-]")
    axes.set_title("Convergence of the interface problem")
    axes.grid(which="both", alpha=0.25)
    # Where no iteration was needed the axis would be one of fractions.
    longest = max((len(history) for histories in curves.values() for history in histories), default=1)
    margin = 0.02 * max(longest - 1, 1) + 0.05
    axes.set_xlim(-margin, max(longest - 1, 1) + margin)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    drawn, names = axes.get_legend_handles_labels()
    if drawn:
        every = -(-len(drawn) // MOST_NAMED)
        axes.legend(drawn[::every], names[::every], fontsize="x-small", ncols=1 if len(drawn) <= 4 else 2)
    return figure


def _shorten(label: str) -> str:
    """A label, or its end where it is long: results of one series differ there."""
    return label if len(label) <= LONGEST_LABEL else f"…{label[1 - LONGEST_LABEL:]}"
