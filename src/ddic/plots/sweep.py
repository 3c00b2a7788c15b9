"""A sweep over cut-off wavelengths and element sizes: L-curve, residual, errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ddic.plots.canvas import COLOURS

Array = NDArray[np.float64]

MOST_LABELS = 12
"""Wavelengths that are written at an axis."""

CROWDED = 0.07
"""Distance of points of the L-curve, relative to the axes, below which only one of them has its wavelength written."""


WIDE_RANGE = 10.0
"""Largest over least residual from which on its axis is logarithmic."""


@dataclass(frozen=True, eq=False)
class SweptElements:
    """What was found with elements of one size, by increasing wavelength.

    Attributes
    ----------
    name : str
        Of the elements.
    wavelengths : (n,) array
        Pixels; 0 without regularization.
    residuals, gaps : (n,) array
        RMS residual, grey levels, and forces out of equilibrium, 1/px.
    predicted, virtual : (n,) array
        Errors, pixels; nan where there is none.
    recommended : int or None
        Which is recommended, of these.
    """

    name: str
    wavelengths: Array
    residuals: Array
    gaps: Array
    predicted: Array
    virtual: Array
    recommended: int | None


def draw_sweep(swept: Sequence[SweptElements], title: str) -> Figure:
    """Draw the L-curve, the residual and the errors against the wavelength; the recommendation is marked by a ring."""
    import matplotlib as mpl

    figure = Figure(figsize=(14.0, 4.9), layout="constrained")
    corner, residual, error = figure.subplots(1, 3)
    colours = mpl.colormaps[COLOURS](np.linspace(0.0, 0.88, max(len(swept), 2)))
    lengths = np.unique(np.concatenate([of_size.wavelengths for of_size in swept]))
    places = _place(lengths)
    for of_size, colour in zip(swept, colours, strict=False):
        x = places[np.searchsorted(lengths, of_size.wavelengths)]
        style = {"color": colour, "linewidth": 1.4, "markersize": 4.5}
        corner.semilogx(of_size.gaps, of_size.residuals, "o-", label=of_size.name, **style)
        residual.semilogx(x, of_size.residuals, "o-", **style)
        error.loglog(x, of_size.virtual, "o-", **style)
        error.loglog(x, np.where(of_size.predicted > 0, of_size.predicted, np.nan), ":", color=colour, linewidth=1.2)
        if of_size.recommended is not None:
            k = of_size.recommended
            for axes, here, values in ((corner, of_size.gaps, of_size.residuals), (residual, x, of_size.residuals),
                                       (error, x, of_size.virtual)):
                axes.plot(here[k], values[k], "o", markersize=13, markerfacecolor="none", markeredgecolor="crimson",
                            markeredgewidth=1.8)
    _annotate(corner, swept)
    _finish(corner, residual, error, (lengths, places))
    figure.suptitle(title, fontsize=11)
    return figure


def _place(lengths: Array) -> Array:
    """Places of wavelengths on a logarithmic axis: none stands left of the shortest."""
    regularized = lengths[lengths > 0]
    left = float(regularized[0]) / 2 if len(regularized) else 1.0
    return np.where(lengths > 0, lengths, left)


def _annotate(axes: Axes, swept: Sequence[SweptElements]) -> None:
    """Write wavelengths at the points of the first curve."""
    first = next((of_size for of_size in swept if np.isfinite(of_size.residuals * of_size.gaps).any()), None)
    if first is None:
        return
    points = np.column_stack([np.log(first.gaps), first.residuals])
    places = (points - np.nanmin(points, axis=0)) / np.maximum(np.ptp(points[np.isfinite(points).all(axis=1)], axis=0),
                                                              1e-300)
    written: list[Array] = []
    # From the longest on: the corner is crowded, the ends are not.
    for k in reversed(range(len(places))):
        if not np.isfinite(places[k]).all() or any(np.abs(places[k] - other).max() < CROWDED for other in written):
            continue
        written.append(places[k])
        text = f"{first.wavelengths[k]:g}" if first.wavelengths[k] else "none"
        axes.annotate(text, (first.gaps[k], first.residuals[k]), xytext=(5, 5), textcoords="offset points", fontsize=7)


def _finish(corner: Axes, residual: Axes, error: Axes, lengths: tuple[Array, Array]) -> None:
    """Labels, grids and legends."""
    corner.set(title="L-curve (numbers: l_c [px])", xlabel="forces out of equilibrium, RMS of div s / E [1/px]")
    corner.legend(fontsize="small", title="elements", title_fontsize="small")
    residual.set_title("residual")
    error.set(title="error of the displacement", ylabel="RMS error [px]")
    error.plot([], [], "ko-", markersize=4.5, label="on the virtual images")
    error.plot([], [], "k:", label="as the residual predicts")
    error.legend(fontsize="small")
    for axes in (corner, residual):
        axes.set_ylabel("RMS residual [grey levels]")
        low, high = axes.dataLim.intervaly
        if high > WIDE_RANGE * low:
            axes.set_yscale("log")
    # Room for the numbers at the ends.
    corner.margins(x=0.14)
    wavelengths, places = lengths
    # At most MOST_LABELS, the first and the last among them.
    n = len(places)
    chosen = sorted({int(k) for k in np.rint(np.linspace(0, n - 1, min(n, MOST_LABELS)))})
    for axes in (residual, error):
        axes.set_xlabel("cut-off wavelength l_c [px]")
        axes.set_xticks(places[chosen], [f"{wavelengths[k]:g}" if wavelengths[k] else "none" for k in chosen],
                        fontsize=8)
        axes.set_xticks([], minor=True)
    for axes in (corner, residual, error):
        axes.grid(which="both", alpha=0.25)
