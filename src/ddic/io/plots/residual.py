"""The map of the correlation residual."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.io.plots.canvas import (
    MOST_SHARP_CELLS,
    Limits,
    add_colour_bar,
    choose_limits,
    find_mesh_bounds,
    make_cell_polygons,
    make_image_figure,
    set_bounds,
)
from ddic.io.plots.length_unit import PIXELS, LengthUnit
from ddic.io.plots.preview import LARGEST_SIDE, find_thinned_extent
from ddic.io.result_reader import Result
from ddic.io.result_schema import RESIDUAL_RMS

PALETTE, SIGNED_PALETTE = "magma", "RdBu_r"
SHOWN_PERCENT = 99.5
LABEL = "grey levels"


def draw_residual(result: Result, *, signed: bool = False, unit: LengthUnit = PIXELS,
                  limits: Limits | None = None) -> Figure:
    """Draw the residual f(x) - g(x + u) by pixel, or its RMS by cell if there is no residual image.

    Colours end at the 99.5 % quantile of absolute values, so that single bad pixels do not darken the rest.

    Parameters
    ----------
    result : Result
        With or without residual image.
    signed : bool, optional
        With its sign, 0 in white; absolute values otherwise.
    unit : LengthUnit, optional
        Of the axes.
    limits : (float, float), optional
        Of the colours, grey levels.

    Returns
    -------
    Figure
        The page.

    Raises
    ------
    InputError
        Where a sign is asked for and there is no residual image.
    """
    image = result.residual_image
    if image is None:
        if signed:
            raise InputError(f"{result.path}: holds no residual image, hence no signs; measure with "
                             "output.residual_image = true, or choose --kind residual")
        return _by_cell(result, unit, limits)
    bounds = find_mesh_bounds(unit.size * result.mesh.nodes)
    std = float(np.nanstd(image)) if np.isfinite(image).any() else float("nan")
    name = "Signed correlation residual" if signed else "Correlation residual"
    figure, axes = make_image_figure(bounds, f"{name}, standard deviation {std:.3g} grey levels", unit)
    step = -(-max(image.shape) // LARGEST_SIDE)
    shown = image[::step, ::step] if signed else np.abs(image[::step, ::step])
    extent = find_thinned_extent(shown.shape, step)
    low, high = limits or _span_shown(shown, signed)
    left, right, bottom, top = (unit.size * edge for edge in extent)
    colours = axes.imshow(shown, cmap=SIGNED_PALETTE if signed else PALETTE, vmin=low, vmax=high,
                          interpolation="nearest", extent=(left, right, bottom, top), rasterized=True)
    set_bounds(axes, bounds)
    symbol = "$f(x) - g(x + u)$" if signed else "$|f(x) - g(x + u)|$"
    add_colour_bar(figure, axes, colours, f"{symbol} [{LABEL}]")
    return figure


def find_residual_limits(result: Result, *, signed: bool = False) -> Limits:
    """Find where the colours of a residual begin and end.

    Parameters
    ----------
    result : Result
        With or without residual image.
    signed : bool, optional
        Whether it is drawn with its sign.

    Returns
    -------
    (float, float)
        Grey levels.
    """
    image = result.residual_image
    if image is None:
        return choose_limits(result.cell_data[RESIDUAL_RMS])
    step = -(-max(image.shape) // LARGEST_SIDE)
    return _span_shown(image[::step, ::step], signed)


def _span_shown(shown: NDArray[np.float32], signed: bool) -> Limits:
    """Where colours begin and end: 0 in the middle of signed values, at the beginning of others."""
    finite = shown[np.isfinite(shown)]
    top = float(np.percentile(np.abs(finite), SHOWN_PERCENT)) if finite.size else 1.0
    top = top or 1.0
    return (-top if signed else 0.0), top


def _by_cell(result: Result, unit: LengthUnit, limits: Limits | None) -> Figure:
    """RMS by cell in colour."""
    nodes, values = unit.size * result.mesh.nodes, result.cell_data[RESIDUAL_RMS]
    figure, axes = make_image_figure(find_mesh_bounds(nodes), "Correlation residual by cell", unit)
    cells = make_cell_polygons(result.mesh, nodes, array=values, cmap=PALETTE, edgecolors="face", linewidths=0.1,
                               clim=choose_limits(values, limits), rasterized=result.mesh.n_cells > MOST_SHARP_CELLS)
    axes.add_collection(cells)
    add_colour_bar(figure, axes, cells, f"RMS of $f(x) - g(x + u)$ [{LABEL}]")
    return figure
