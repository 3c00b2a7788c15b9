"""The map of the correlation residual."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ddic.io.plots.canvas import add_colour_bar, find_mesh_bounds, make_cell_polygons, make_image_figure
from ddic.io.plots.preview import LARGEST_SIDE, find_thinned_extent
from ddic.io.result_reader import Result
from ddic.io.result_schema import RESIDUAL_RMS

PALETTE = "magma"
SHOWN_PERCENT = 99.5
LABEL = "grey levels"


def draw_residual(result: Result) -> Figure:
    """Draw the absolute residual |f(x) - g(x + u)| by pixel, or its RMS by cell if there is no residual image.

    Colours end at the 99.5 % quantile, so that single bad pixels do not darken the rest.

    Parameters
    ----------
    result : Result
        With or without residual image.

    Returns
    -------
    Figure
        The page.
    """
    image = result.residual_image
    bounds = find_mesh_bounds(result.mesh.nodes)
    if image is None:
        return _by_cell(result, bounds)
    std = float(np.nanstd(image)) if np.isfinite(image).any() else float("nan")
    figure, axes = make_image_figure(bounds, f"Correlation residual, standard deviation {std:.3g} grey levels")
    step = -(-max(image.shape) // LARGEST_SIDE)
    shown = np.abs(image[::step, ::step])
    finite = shown[np.isfinite(shown)]
    top = float(np.percentile(finite, SHOWN_PERCENT)) if finite.size else 1.0
    picture = axes.imshow(shown, cmap=PALETTE, vmin=0.0, vmax=top or 1.0, interpolation="nearest",
                          extent=find_thinned_extent(shown.shape, step))
    axes.set_xlim(bounds[0], bounds[2])
    axes.set_ylim(bounds[3], bounds[1])
    add_colour_bar(figure, axes, picture, f"$|f(x) - g(x + u)|$ [{LABEL}]")
    return figure


def _by_cell(result: Result, bounds: tuple[float, float, float, float]) -> Figure:
    """RMS by cell in colour."""
    figure, axes = make_image_figure(bounds, "Correlation residual by cell")
    cells = make_cell_polygons(result.mesh, result.mesh.nodes, array=result.cell_data[RESIDUAL_RMS], cmap=PALETTE,
                               edgecolors="face", linewidths=0.1)
    axes.add_collection(cells)
    add_colour_bar(figure, axes, cells, f"RMS of $f(x) - g(x + u)$ [{LABEL}]")
    return figure
