"""The functions of x and of y that a separated displacement is made of (Fig. 9 and 10 of [PP12])."""

from __future__ import annotations

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from ddic.io.plots.canvas import COLOURS
from ddic.separated.field import SeparatedField

MOST = 5
"""Modes that are drawn, the largest ones; a larger value crowds the axes."""

LIGHTEST = 0.85
"""Place in the colours of the last mode, 0 to 1; a larger value is lighter."""


def draw_modes(field: SeparatedField) -> Figure:
    """Draw the functions of the largest modes of both components.

    Parameters
    ----------
    field : SeparatedField
        The displacement.

    Returns
    -------
    Figure
        The page: functions of x above, of y below, one column a component.
    """
    figure = Figure(figsize=(9.0, 6.0), layout="tight")
    panels = figure.subplots(2, 2)
    n = min(MOST, field.n_modes)
    shades = colormaps[COLOURS](np.linspace(0.0, LIGHTEST, n))
    for c, component in enumerate("xy"):
        for row, (name, line, functions) in enumerate((("x", field.along_x, field.x), ("y", field.along_y, field.y))):
            axes = panels[row, c]
            for k, shade in enumerate(shades):
                axes.plot(line.nodes, functions[k, c], color=shade, linewidth=1.2,
                          label=f"mode {k + 1}, {field.amplitudes[k, c]:.2g} px")
            axes.set_xlabel(f"{name} [px]")
            axes.set_ylabel(f"function of {name}, u_{component} [-]")
            axes.grid(alpha=0.25)
            if not row and n:
                axes.legend(fontsize="x-small", title="RMS displacement", title_fontsize="x-small")
    figure.suptitle(f"{n} largest of {field.n_modes} modes")
    return figure
