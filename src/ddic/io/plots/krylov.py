"""Convergence curves of the Krylov iterations (Fig. 11 of [BP17])."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ddic.io.plots.canvas import COLOURS

STYLES = ("-", "--", "-.", ":")

LIGHTEST = 0.85
"""Place in the colours of the last iteration, 0 to 1; a larger value is lighter."""


def draw_krylov(curves: Mapping[str, Sequence[NDArray[np.float64]]]) -> Figure:
    """Draw the relative residual against the iteration.

    Each label has a line style; its Gauss-Newton iterations run through the colours.

    Parameters
    ----------
    curves : dict of sequence of (n,) array
        Label -> histories, one array for each Gauss-Newton iteration.

    Returns
    -------
    Figure
        The page.
    """
    figure = Figure(figsize=(7.0, 4.5), layout="tight")
    axes = figure.add_subplot()
    for style, (label, histories) in zip(cycle(STYLES), curves.items(), strict=False):
        shades = colormaps[COLOURS](np.linspace(0.0, LIGHTEST, len(histories)))
        for number, (history, shade) in enumerate(zip(histories, shades, strict=True), start=1):
            if len(history) == 0:
                continue
            # A history that ends at an exact zero has no logarithm: its last point is not drawn.
            shown = np.where(np.asarray(history) > 0, history, np.nan)
            label_of_curve = f"{label}, Gauss-Newton {number}"
            axes.semilogy(np.arange(len(shown)), shown, style, color=shade, linewidth=1.4, label=label_of_curve)
    axes.set_xlabel("Krylov iteration [-]")
    axes.set_ylabel("relative residual [-]")
    axes.set_title("Convergence of the interface problem")
    axes.grid(which="both", alpha=0.25)
    curves_drawn, _ = axes.get_legend_handles_labels()
    if curves_drawn:
        axes.legend(fontsize="small", ncols=2)
    return figure
