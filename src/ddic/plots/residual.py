"""The map of the correlation residual.

How residuals and grey levels are distributed.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.io.result_reader import Result
from ddic.io.result_schema import RESIDUAL_RMS
from ddic.plots import canvas
from ddic.plots.canvas import PIXELS, LengthUnit, Limits
from ddic.plots.maps import LARGEST_SIDE, find_thinned_extent

PALETTE, SIGNED_PALETTE = "magma", "RdBu_r"
SHOWN_PERCENT = 99.5
LABEL = "grey levels"


def draw_residual(result: Result, *, signed: bool = False, unit: LengthUnit = PIXELS,
                  limits: Limits | None = None) -> Figure:
    """Draw the residual f(x) - g(x + u) by pixel, or its RMS by cell if there is no residual image.

    Colours end at the 99.5 % quantile of absolute values, so that single bad pixels do not darken the rest. If
    ``signed``, 0 is white; absolute values are drawn otherwise. Raises InputError where a sign is asked for and there
    is no residual image.
    """
    image = result.residual_image
    if image is None:
        if signed:
            raise InputError(f"{result.path}: holds no residual image, hence no signs; measure with "
                             "output.residual_image = true, or choose --kind residual")
        return _by_cell(result, unit, limits)
    bounds = canvas.find_mesh_bounds(unit.size * result.mesh.nodes)
    std = float(np.nanstd(image)) if np.isfinite(image).any() else float("nan")
    name = "Signed correlation residual" if signed else "Correlation residual"
    figure, axes = canvas.make_image_figure(bounds, f"{name}, standard deviation {std:.3g} grey levels", unit)
    thinned, step = _thin(image)
    low, high = limits or _span_shown(thinned, signed)
    colours = axes.imshow(thinned if signed else np.abs(thinned), cmap=SIGNED_PALETTE if signed else PALETTE, vmin=low,
                          vmax=high, interpolation="nearest", rasterized=True,
                          extent=find_thinned_extent(thinned.shape, step, unit.size))
    canvas.set_bounds(axes, bounds)
    symbol = "$f(x) - g(x + u)$" if signed else "$|f(x) - g(x + u)|$"
    canvas.add_colour_bar(figure, axes, colours, f"{symbol} [{LABEL}]")
    return figure


def find_residual_limits(result: Result, *, signed: bool = False) -> Limits:
    """Find where the colours of a residual begin and end, grey levels."""
    image = result.residual_image
    if image is None:
        return canvas.choose_limits(result.cell_data[RESIDUAL_RMS])
    return _span_shown(_thin(image)[0], signed)


def _thin(image: NDArray[np.float32]) -> tuple[NDArray[np.float32], int]:
    """What a figure can show of an image, and the pixels from one that is kept to the next."""
    step = -(-max(image.shape) // LARGEST_SIDE)
    return image[::step, ::step], step


def _span_shown(shown: NDArray[np.float32], signed: bool) -> Limits:
    """Where colours begin and end: 0 in the middle of signed values, at the beginning of others."""
    finite = shown[np.isfinite(shown)]
    top = float(np.percentile(np.abs(finite), SHOWN_PERCENT)) if finite.size else 1.0
    top = top or 1.0
    return (-top if signed else 0.0), top


def _by_cell(result: Result, unit: LengthUnit, limits: Limits | None) -> Figure:
    """RMS by cell in colour."""
    nodes, values = unit.size * result.mesh.nodes, result.cell_data[RESIDUAL_RMS]
    figure, axes = canvas.make_image_figure(canvas.find_mesh_bounds(nodes), "Correlation residual by cell", unit)
    cells = canvas.draw_cell_colours(axes, result.mesh, nodes, values, canvas.choose_limits(values, limits), PALETTE)
    canvas.add_colour_bar(figure, axes, cells, f"RMS of $f(x) - g(x + u)$ [{LABEL}]")
    return figure


N_BINS = 120
"""Of a histogram; more show the noise of their counts."""

WIDEST = 6.0
"""Standard deviations to either side of 0 that are shown of residuals."""

HISTOGRAM_COLOURS = ("tab:blue", "tab:orange")


def draw_residual_histogram(residual: NDArray[np.float32]) -> Figure:
    """Draw the distribution of the residual beside the normal one of the same standard deviation.

    Tails above the normal ones are not noise.
    """
    values = residual[np.isfinite(residual)].astype(np.float64)
    std = float(values.std()) if values.size else 1.0
    # Of a residual of one value, such as 0, the curve is that of any deviation.
    std = std or 1.0
    edge = WIDEST * std
    figure = Figure(figsize=(5.0, 3.4), layout="tight")
    axes = figure.subplots()
    counts, edges = np.histogram(values, bins=N_BINS, range=(-edge, edge))
    density = counts / max(values.size, 1) / np.diff(edges)
    axes.stairs(density, edges, fill=True, color="tab:blue", alpha=0.6, label="residual")
    x = np.linspace(-edge, edge, 400)
    normal = np.exp(-0.5 * (x / std)**2) / (std * np.sqrt(2.0 * np.pi))
    axes.plot(x, normal, color="black", linewidth=1.2, label="normal, same deviation")
    axes.set_yscale("log")
    axes.set_ylim(bottom=1e-6 / std)
    axes.set(xlabel="$f(x) - g(x + u)$ [grey levels]", ylabel="density [1 / grey level]")
    axes.legend(fontsize="small", loc="lower center")
    return figure


def draw_grey_histogram(images: Mapping[str, NDArray[Any]]) -> Figure:
    """Draw the distribution of the grey levels of images, by their names."""
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
    axes.set(xlabel="grey level", ylabel="density [1 / grey level]")
    axes.set_ylim(bottom=0.0)
    axes.legend(fontsize="small")
    return figure
