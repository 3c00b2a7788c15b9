"""The difference between two measured fields (Fig. 10 of [BP17])."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ddic.io.plots.canvas import (
    COLOURS,
    Component,
    add_colour_bar,
    find_mesh_bounds,
    format_component,
    make_image_figure,
    make_triangulation,
    pick_component,
)
from ddic.io.result_reader import Result, displacement_at


def draw_difference(result: Result, other: Result, component: Component = "magnitude") -> Figure:
    """Draw the displacement of a result minus another's.

    Parameters
    ----------
    result : Result
        On whose nodes it is drawn.
    other : Result
        Interpolated there.
    component : {"x", "y", "magnitude"}, optional
        What is in colour, pixels.

    Returns
    -------
    Figure
        The page.
    """
    mesh = result.mesh
    difference = result.displacement - displacement_at(other, mesh.nodes)
    rms = float(np.sqrt(np.mean(np.sum(difference**2, axis=1))))
    figure, axes = make_image_figure(
        find_mesh_bounds(mesh.nodes), f"{result.path.name} minus {other.path.name}, RMS {rms:.2e} px")
    colours = axes.tripcolor(make_triangulation(mesh, mesh.nodes), pick_component(difference, component),
                             shading="gouraud", cmap=COLOURS)
    add_colour_bar(figure, axes, colours, f"{format_component(chr(92) + 'Delta u', component)} [px]")
    return figure
