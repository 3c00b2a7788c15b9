"""How residuals and grey levels are distributed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

N_BINS = 120
"""Of a histogram; more show the noise of their counts."""

WIDEST = 6.0
"""Standard deviations to either side of 0 that are shown of residuals."""

HISTOGRAM_COLOURS = ("tab:blue", "tab:orange")


def draw_residual_histogram(residual: NDArray[np.float32]) -> Figure:
    """Draw the distribution of the residual beside the normal one of the same standard deviation.

    Parameters
    ----------
    residual : (height, width) array
        f(x) - g(x + u), grey levels; nan where there is none.

    Returns
    -------
    Figure
        The page; tails above the normal ones are not noise.
    """
    values = residual[np.isfinite(residual)].astype(np.float64)
    std = float(values.std()) if values.size else 1.0
    edge = WIDEST * (std or 1.0)
    figure = Figure(figsize=(5.0, 3.4), layout="tight")
    axes = figure.subplots()
    counts, edges = np.histogram(values, bins=N_BINS, range=(-edge, edge))
    density = counts / max(values.size, 1) / np.diff(edges)
    axes.stairs(density, edges, fill=True, color="tab:blue", alpha=0.6, label="residual")
    x = np.linspace(-edge, edge, 400)
    axes.plot(x, np.exp(-0.5 * (x / (std or 1.0))**2) / ((std or 1.0) * np.sqrt(2.0 * np.pi)), color="black",
              linewidth=1.2, label="normal, same deviation")
    axes.set_yscale("log")
    axes.set_ylim(bottom=1e-6 / (std or 1.0))
    axes.set_xlabel("$f(x) - g(x + u)$ [grey levels]")
    axes.set_ylabel("density [1 / grey level]")
    axes.legend(fontsize="small", loc="lower center")
    return figure


def draw_grey_histogram(images: Mapping[str, NDArray[Any]]) -> Figure:
    """Draw the distribution of the grey levels of images.

    Parameters
    ----------
    images : mapping of (height, width) array
        By name.

    Returns
    -------
    Figure
        The page.
    """
    figure = Figure(figsize=(5.0, 3.4), layout="tight")
    axes = figure.subplots()
    finite = {name: pixels[np.isfinite(pixels)] for name, pixels in images.items()}
    low, high = (float(edge([edge(pixels) for pixels in finite.values()])) for edge in (np.min, np.max))
    # Bins of whole grey levels: others would hold now one level, now two.
    width = max(1.0, np.ceil((high - low + 1.0) / N_BINS)) if high - low > 1.0 else (high - low or 1.0) / N_BINS
    edges = np.arange(low - 0.5 * min(width, 1.0), high + width, width)
    for (name, pixels), colour in zip(finite.items(), HISTOGRAM_COLOURS, strict=False):
        density = np.histogram(pixels, edges)[0] / pixels.size / width
        axes.stairs(density, edges, color=colour, linewidth=1.4, label=name)
    axes.set_xlabel("grey level")
    axes.set_ylabel("density [1 / grey level]")
    axes.set_ylim(bottom=0.0)
    axes.legend(fontsize="small")
    return figure
