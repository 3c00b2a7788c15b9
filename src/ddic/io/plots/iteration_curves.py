"""How Gauss-Newton converges: corrections and residual against their number."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray


def draw_iterations(table: Mapping[str, NDArray[Any]], noise_floor: float = float("nan")) -> Figure:
    """Draw the size of corrections, beside the noise floor, and the residual before each of them.

    Parameters
    ----------
    table : mapping of (n_iterations,) array
        Columns of the result file's table of iterations.
    noise_floor : float, optional
        Of the displacement, pixels; nan where it is not known.

    Returns
    -------
    Figure
        The page.
    """
    figure = Figure(figsize=(5.6, 4.4), layout="tight")
    sizes, residual = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    number = table["iteration"]
    for column, colour, label in (("rms_correction_px", "tab:blue", "RMS"),
                                  ("largest_correction_px", "tab:orange", "largest")):
        if column in table:
            values = np.where(table[column] > 0, table[column], np.nan)
            sizes.semilogy(number, values, marker="o", markersize=4, color=colour, label=label)
    if np.isfinite(noise_floor) and noise_floor > 0:
        sizes.axhline(noise_floor, linestyle="--", color="tab:grey", label="noise floor")
    sizes.set_ylabel("correction [px]")
    sizes.legend(fontsize="small")
    residual.plot(number, table["residual_std_grey"], marker="o", markersize=4)
    residual.set_ylabel("residual before it\n[grey levels]")
    residual.set_ylim(0.0, 1.15 * float(np.nanmax(table["residual_std_grey"])) or 1.0)
    residual.set_xlabel("iteration [-]")
    for axes in (sizes, residual):
        axes.set_xlim(number.min() - 0.5, number.max() + 0.5)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
        axes.grid(which="both", alpha=0.25)
    return figure
