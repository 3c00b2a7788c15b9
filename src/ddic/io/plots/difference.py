"""The difference between two measured fields (Fig. 10 of [BP17])."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ddic.io.plots.canvas import (
    COLOURS,
    Component,
    Limits,
    add_colour_bar,
    choose_limits,
    find_mesh_bounds,
    format_component,
    make_image_figure,
    make_triangulation,
    pick_component,
)
from ddic.io.plots.length_unit import PIXELS, LengthUnit
from ddic.io.result_reader import Result, displacement_at


def draw_difference(result: Result, other: Result, component: Component = "magnitude", unit: LengthUnit = PIXELS,
                    limits: Limits | None = None) -> Figure:
    """Draw the displacement of a result minus another's.

    Parameters
    ----------
    result : Result
        On whose nodes it is drawn.
    other : Result
        Interpolated there.
    component : {"x", "y", "magnitude"}, optional
        What is in colour.
    unit : LengthUnit, optional
        Of axes and colours.
    limits : (float, float), optional
        Of the colours, in that unit.

    Returns
    -------
    Figure
        The page.
    """
    mesh, nodes = result.mesh, unit.size * result.mesh.nodes
    difference = unit.size * (result.displacement - displacement_at(other, mesh.nodes))
    rms = float(np.sqrt(np.mean(np.sum(difference**2, axis=1))))
    title = f"{result.path.name} minus {other.path.name}, RMS {rms:.2e} {unit.name}"
    figure, axes = make_image_figure(find_mesh_bounds(nodes), title, unit)
    values = pick_component(difference, component)
    low, high = choose_limits(values, limits)
    colours = axes.tripcolor(make_triangulation(mesh, nodes), values, shading="gouraud", cmap=COLOURS, vmin=low,
                             vmax=high, rasterized=True)
    add_colour_bar(figure, axes, colours, f"{format_component(chr(92) + 'Delta u', component)} [{unit.name}]")
    return figure
