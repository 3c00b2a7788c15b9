"""How PGD-DIC converges: corrections and residual against their number (Fig. 8 of [PP12])."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray


def draw_corrections(table: Mapping[str, NDArray[Any]]) -> Figure:
    """Draw the size of corrections, what they gain and the residual before them, its standard deviation.

    Parameters
    ----------
    table : mapping of (n_corrections,) array
        Columns of the result file's table of corrections.

    Returns
    -------
    Figure
        The page.
    """
    figure = Figure(figsize=(10.0, 3.6), layout="tight")
    sizes, gains, residual = figure.subplots(1, 3)
    number = table["correction"]
    for component, colour in (("x", "tab:blue"), ("y", "tab:orange")):
        sizes.semilogy(number, _positive(table[f"fluctuation_{component}"]), color=colour, marker="o", markersize=3,
                       label=f"of u_{component} without its mean")
        sizes.semilogy(number, _positive(table[f"relative_{component}"]), "--", color=colour,
                       label=f"of u_{component} (the paper's eta)")
    sizes.set_ylabel("RMS of the correction [-]")
    gains.semilogy(number, _positive(table["gain"]), color="tab:blue", marker="o", markersize=3, label="correction")
    gains.semilogy(number, _positive(table["noise_gain"]), "--", color="tab:grey", label="of noise")
    gains.set_ylabel("gain [grey levels²]")
    residual.plot(number, table["residual_std_grey"], color="tab:blue", marker="o", markersize=3)
    residual.set_ylabel("residual before it [grey levels]")
    residual.set_ylim(bottom=0.0)
    for axes in (sizes, gains, residual):
        axes.set_xlabel("correction [-]")
        # One correction alone would have an axis of fractions.
        axes.set_xlim(number.min() - 0.5, number.max() + 0.5)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
        axes.grid(which="both", alpha=0.25)
    for axes in (sizes, gains):
        axes.legend(fontsize="x-small")
    return figure


def _positive(values: NDArray[Any]) -> NDArray[np.float64]:
    """Values that have a logarithm, nan for others."""
    return np.where(values > 0, values, np.nan).astype(np.float64)
