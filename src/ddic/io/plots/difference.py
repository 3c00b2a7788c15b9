"""The difference between two measured fields (Fig. 10 of [BP17])."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ddic.io.plots.canvas import (
    Component,
    Limits,
    add_colour_bar,
    choose_limits,
    draw_nodal_colours,
    find_mesh_bounds,
    format_component,
    make_image_figure,
    pick_component,
)
from ddic.io.plots.length_unit import PIXELS, LengthUnit
from ddic.io.result_reader import Result, displacement_at
from ddic.mesh.interpolation import locate


def draw_difference(result: Result, other: Result, component: Component = "magnitude", unit: LengthUnit = PIXELS,
                    limits: Limits | None = None) -> Figure:
    """Draw the displacement of a result minus another's.

    Parameters
    ----------
    result : Result
        On whose nodes it is drawn.
    other : Result
        Interpolated there; where either was not measured nothing is drawn.
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
    difference = unit.size * (result.displacement - _interpolate(other, mesh.nodes))
    squares = np.sum(difference**2, axis=1)
    is_known = np.isfinite(squares)
    rms = float(np.sqrt(squares[is_known].mean())) if is_known.any() else np.nan
    title = f"{result.path.name} minus {other.path.name}, RMS {rms:.2e} {unit.name}"
    figure, axes = make_image_figure(find_mesh_bounds(nodes), title, unit)
    values = pick_component(difference, component)
    colours = draw_nodal_colours(axes, mesh, nodes, values, choose_limits(values, limits))
    add_colour_bar(figure, axes, colours, f"{format_component(chr(92) + 'Delta u', component)} [{unit.name}]")
    return figure


def _interpolate(result: Result, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Displacement at points, pixels: a guess outside the mesh, nan in it where nothing was measured."""
    values = displacement_at(result, points)
    if not result.measured_nodes.all():
        is_unmeasured = np.isnan(result.at(points)).any(axis=1) & (locate(result.mesh, points).cells >= 0)
        values[is_unmeasured] = np.nan
    return values
