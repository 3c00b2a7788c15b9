"""Near-field and far-field measurements: where each camera measured, and panels of cell values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ddic.io.result_reader import Result
from ddic.io.result_schema import CAMERA, near_group
from ddic.mesh.mesh import Mesh
from ddic.mesh.topology import find_boundary_facets
from ddic.plots.canvas import (
    COLOURS,
    PIXELS,
    WIDTH_INCHES,
    Bounds,
    Component,
    LengthUnit,
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

OUTLINE = "white"

AROUND = 0.12
"""Around a near field, relative to its longer side."""

HIDDEN_PERCENT = 0.5
"""Share of the values, on either side, that colours do not span; a larger value shows more of what is between."""


@dataclass(frozen=True)
class CellPanel:
    """A value on each cell of a mesh.

    Attributes
    ----------
    title : str
        Above the panel.
    mesh : Mesh
        Pixels of the far field.
    values : (n_cells,) array
        Of any unit.
    """

    title: str
    mesh: Mesh
    values: NDArray[np.float64]


def find_near_mesh(result: Result, camera: int) -> Mesh:
    """Find the cells that a camera measured, in pixels of the far field."""
    return result.mesh.create_submesh(np.flatnonzero(result.cell_data[CAMERA] == camera))[0]


def draw_near_far(result: Result, component: Component = "magnitude", unit: LengthUnit = PIXELS) -> Figure:
    """Draw the displacement of the whole mesh, then around each near field in colours of its own.

    Near fields are outlined; titles tell alpha, in pixels, by which each near set-up moved.
    """
    last_camera = int(result.cell_data[CAMERA].max())
    cameras = range(1, last_camera + 1)
    near = [_scale(find_near_mesh(result, camera), unit) for camera in cameras]
    whole = _scale(result.mesh, unit)
    titles = ["far field", *(_moved(result, camera) for camera in cameras)]
    boxes = [find_mesh_bounds(whole.nodes), *(find_mesh_bounds(mesh.nodes, AROUND) for mesh in near)]
    figure, panels = make_panels(boxes, titles, unit)
    values = unit.size * pick_component(result.displacement, component)
    for axes, box in zip(panels, boxes, strict=True):
        inside = values[_in_box(whole.nodes, box)]
        colours = draw_nodal_colours(axes, whole, whole.nodes, values, choose_limits(inside))
        _outline(axes, near)
        set_bounds(axes, box)
        add_colour_bar(figure, axes, colours, f"{format_component('u', component)} [{unit.name}]")
    return figure


def _scale(mesh: Mesh, unit: LengthUnit) -> Mesh:
    """A mesh in the unit of the axes."""
    return replace(mesh, nodes=unit.size * mesh.nodes)


def draw_cell_panels(panels: Sequence[CellPanel], outlined: Sequence[Mesh], box: Bounds, label: str) -> Figure:
    """Draw panels of one part of the image with common colours, two in a row, at least one.

    Colours span what the last panel shows, without the outermost 0.5 % on either side. ``box`` is x0, y0, x1, y1 of the
    part, pixels; the outlines of ``outlined`` are drawn in all panels.
    """
    last = panels[-1]
    centres = np.array([last.mesh.nodes[cell[cell >= 0]].mean(axis=0) for cell in last.mesh.cells])
    shown = last.values[_in_box(centres, box)]
    low, high = np.nanpercentile(shown, [HIDDEN_PERCENT, 100 - HIDDEN_PERCENT])
    figure, all_axes = _page(len(panels), box)
    for axes, panel in zip(all_axes, panels, strict=True):
        cells = make_cell_polygons(panel.mesh, panel.mesh.nodes, array=panel.values, cmap=COLOURS, edgecolors="face",
                                   linewidths=0.1, clim=(low, high))
        axes.add_collection(cells)
        _finish(axes, panel.title, box, outlined)
    figure.colorbar(cells, ax=all_axes, label=label, extend="both", shrink=0.7)
    return figure


def _page(n: int, box: Bounds) -> tuple[Figure, list[Axes]]:
    """A page with so many panels for a box of pixels."""
    n_columns = min(n, 2)
    n_rows = math.ceil(n / n_columns)
    x0, y0, x1, y1 = box
    panel_width = WIDTH_INCHES / n_columns
    panel_height = panel_width * (y1 - y0) / (x1 - x0)
    # With room for labels and colour bars, and for the title of the page.
    size = (1.25 * WIDTH_INCHES, 1.1 * n_rows * panel_height + 0.8)
    figure = Figure(figsize=size, layout="constrained")
    return figure, [figure.add_subplot(n_rows, n_columns, k + 1) for k in range(n)]


def _outline(axes: Axes, outlined: Sequence[Mesh]) -> None:
    """Outlines of meshes, on grey."""
    for mesh in outlined:
        edges = find_boundary_facets(mesh)[:, :2]
        segments = list(mesh.nodes[edges])
        axes.add_collection(LineCollection(segments, colors=OUTLINE, linewidths=1.2))
    axes.set_facecolor("0.6")


def _finish(axes: Axes, title: str, box: Bounds, outlined: Sequence[Mesh]) -> None:
    """Outlines, limits and title of a panel."""
    _outline(axes, outlined)
    set_bounds(axes, box)
    axes.set_aspect("equal")
    axes.set_xlabel("x [px]")
    axes.set_ylabel("y [px]")
    axes.set_title(title, fontsize="medium")


def _in_box(points: NDArray[np.float64], box: Bounds) -> NDArray[np.bool_]:
    """Which points (n, 2) lie in a box, (n,)."""
    low, high = box[:2], box[2:]
    is_inside = (points >= low) & (points <= high)
    return np.asarray(is_inside.all(axis=1))


def _moved(result: Result, camera: int) -> str:
    """Title of a near field, with its set-up's motion."""
    alpha = result.attributes[near_group(camera)]["alpha_px"]
    return f"near field {camera}, $\\alpha$ = ({alpha[0]:.3f}, {alpha[1]:.3f}) px"
