"""A value at the nodes or on the cells in colour, over the reference image where there is one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import Collection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ddic.io.plots.canvas import (
    COLOURS,
    MOST_SHARP_CELLS,
    Component,
    Limits,
    add_colour_bar,
    choose_limits,
    draw_nodal_colours,
    find_mesh_bounds,
    format_component,
    make_cell_polygons,
    make_panels,
    pick_component,
    set_bounds,
)
from ddic.io.plots.length_unit import PIXELS, LengthUnit
from ddic.io.plots.preview import Preview
from ddic.io.result_reader import Result
from ddic.mesh.mesh import Mesh

MARGIN = 0.06
"""Of the image that is shown around the mesh, relative to its longer side."""

OPACITY = 0.7
"""Share of colours where there is an image below; a larger value hides more of it."""


@dataclass(frozen=True, eq=False)
class Values:
    """What a panel shows.

    Attributes
    ----------
    title : str
        Above the panel.
    label : str
        Of the colour bar, with the unit.
    values : (n_nodes,) or (n_cells,) array
        At the nodes, or on the cells.
    by_cell : bool
        Whether they are on the cells.
    limits : (float, float) or None
        Of its colours; None where they are those of its values, or of all panels.
    """

    title: str
    label: str
    values: NDArray[np.float64]
    by_cell: bool = False
    limits: Limits | None = None


def draw_displacement(result: Result, image: Preview | None = None, component: Component = "magnitude",
                      unit: LengthUnit = PIXELS, limits: Limits | None = None) -> Figure:
    """Draw the displacement on the mesh at rest, over the reference image.

    Parameters
    ----------
    result : Result
        The displacement.
    image : Preview, optional
        Drawn below.
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
    symbol = format_component("u", component)
    shown = Values(f"Displacement {symbol}", f"{symbol} [{unit.name}]",
                   unit.size * pick_component(result.displacement, component))
    return draw_values(result.mesh, [shown], image, unit, limits)


def draw_values(mesh: Mesh, shown: Sequence[Values], image: Preview | None, unit: LengthUnit,
                limits: Limits | None) -> Figure:
    """Draw panels of values on one mesh.

    Parameters
    ----------
    mesh : Mesh
        Pixels.
    shown : sequence of Values
        A panel each.
    image : Preview or None
        Drawn below.
    unit : LengthUnit
        Of the axes.
    limits : (float, float) or None
        Of the colours of all panels that have none of their own; a panel's values tell where it is None too.

    Returns
    -------
    Figure
        The page.
    """
    nodes = unit.size * mesh.nodes
    bounds = find_mesh_bounds(nodes, MARGIN)
    if image is not None:
        bounds = image.clip(bounds, unit.size)
    figure, panels = make_panels([bounds] * len(shown), [panel.title for panel in shown], unit)
    for axes, panel in zip(panels, shown, strict=True):
        colours = _add_colours(axes, mesh, nodes, panel, choose_limits(panel.values, panel.limits or limits))
        if image is not None:
            # The image once more, thinly, and not colours thinly over it: those of triangles would show their edges.
            image.draw(axes, unit.size)
            image.draw(axes, unit.size, opacity=1.0 - OPACITY)
            set_bounds(axes, bounds)
        add_colour_bar(figure, axes, colours, panel.label)
    return figure


def _add_colours(axes: Axes, mesh: Mesh, nodes: NDArray[np.float64], panel: Values, limits: Limits) -> Collection:
    """Colours by node, interpolated, or by cell; nodes: in the axes' unit."""
    if not panel.by_cell:
        return draw_nodal_colours(axes, mesh, nodes, panel.values, limits)
    cells = make_cell_polygons(mesh, nodes, array=panel.values, cmap=COLOURS, edgecolors="face", linewidths=0.1,
                               clim=limits, rasterized=mesh.n_cells > MOST_SHARP_CELLS)
    axes.add_collection(cells)
    return cells
