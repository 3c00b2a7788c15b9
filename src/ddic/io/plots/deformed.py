"""The deformed mesh with a displacement component in colour (Fig. 9 of [BP17])."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ddic.io.plots.canvas import (
    COLOURS,
    Component,
    add_colour_bar,
    find_mesh_bounds,
    format_component,
    make_cell_polygons,
    make_image_figure,
    make_triangulation,
    pick_component,
)
from ddic.io.result_reader import Result

VISIBLE_SHARE = 0.05
MOST_CELLS_WITH_EDGES = 20_000


def choose_amplification(result: Result) -> float:
    """Choose an amplification, one digit, that makes the departure from the mean displacement 5 % of the mesh.

    Parameters
    ----------
    result : Result
        The displacement.

    Returns
    -------
    float
        At least 1.
    """
    departure = result.displacement - result.displacement.mean(axis=0)
    largest = float(np.abs(departure).max())
    if largest == 0.0:
        return 1.0
    wanted = VISIBLE_SHARE * float(np.ptp(result.mesh.nodes, axis=0).max()) / largest
    return max(1.0, float(f"{wanted:.0e}"))


def draw_deformed(result: Result, component: Component = "magnitude",
                  amplification: float | None = None) -> Figure:
    """Draw the mesh moved by its amplified displacement, over its outline at rest in grey.

    Parameters
    ----------
    result : Result
        The displacement.
    component : {"x", "y", "magnitude"}, optional
        What is in colour, pixels.
    amplification : float, optional
        Of the displacement; where it is left out, one that shows.

    Returns
    -------
    Figure
        The page.
    """
    mesh = result.mesh
    factor = choose_amplification(result) if amplification is None else amplification
    moved = mesh.nodes + factor * result.displacement
    bounds = find_mesh_bounds(np.concatenate([mesh.nodes, moved]))
    figure, axes = make_image_figure(bounds, f"Deformed mesh, displacement amplified {factor:g} times")
    axes.add_collection(make_cell_polygons(mesh, mesh.nodes, facecolors="0.9", edgecolors="0.9", linewidths=0.3))
    values = pick_component(result.displacement, component)
    colours = axes.tripcolor(make_triangulation(mesh, moved), values, shading="gouraud", cmap=COLOURS)
    if mesh.n_cells <= MOST_CELLS_WITH_EDGES:
        axes.add_collection(make_cell_polygons(mesh, moved, facecolors="none", edgecolors="black",
                                               linewidths=0.15))
    add_colour_bar(figure, axes, colours, f"{format_component('u', component)} [px]")
    return figure
