"""Four panels of strain: far and near field measured alone, continuous, regularized.

Those of Fig. 4 of [BP17] are meshes displaced 30 times: as measured, less alpha0, by Eq. 21, by Eq. 23.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from accept.support.near_far_case import Fields
from ddic.kinematics.strain import compute_strain
from ddic.mesh.mesh import Mesh
from ddic.plots.canvas import (
    WIDTH_INCHES,
    Bounds,
    draw_cell_colours,
    find_mesh_bounds,
    save_figure,
    set_bounds,
)
from ddic.plots.maps import draw_outlines, find_points_inside

AROUND = 0.35

HIDDEN_PERCENT = 0.5
"""Share of the values, on either side, that colours do not span; a larger value shows more of what is between."""


@dataclass(frozen=True)
class CellPanel:
    """A title, a mesh in pixels of the far field, and a value on each of its cells."""

    title: str
    mesh: Mesh
    values: NDArray[np.float64]


def draw_panels(fields: Mapping[str, Fields], path: Path) -> None:
    """Strain along y around the near field; fields: independent, continuous, regularized."""
    alone, joint, regularized = (fields[name] for name in ("independent", "continuous", "regularized"))
    near = alone.mesh.create_submesh(np.flatnonzero(alone.cells == 1))[0]
    panels = [_panel("(a) far field alone", alone, [0]), _panel("(b) near field alone", alone, [1]),
              _panel("(c) continuous, Eq. 21", joint, [0, 1]), _panel("(d) regularized, Eq. 23", regularized, [0, 1])]
    path.parent.mkdir(parents=True, exist_ok=True)
    save_figure(draw_cell_panels(panels, [near], find_mesh_bounds(near.nodes, AROUND), r"$\varepsilon_{yy}$ [-]"), path)


def _panel(title: str, fields: Fields, cameras: list[int]) -> CellPanel:
    shown = fields.mesh.create_submesh(np.flatnonzero(np.isin(fields.cells, cameras)))[0]
    values = np.concatenate([_strain(fields, camera) for camera in cameras])
    order = np.argsort(np.concatenate([np.flatnonzero(fields.cells == camera) for camera in cameras]))
    return CellPanel(title, shown, values[order])


def _strain(fields: Fields, camera: int) -> NDArray[np.float64]:
    part, _ = fields.mesh.create_submesh(np.flatnonzero(fields.cells == camera))
    return compute_strain(part, fields.u[camera].ravel()).infinitesimal[:, 1]


def draw_cell_panels(panels: Sequence[CellPanel], outlined: Sequence[Mesh], box: Bounds, label: str) -> Figure:
    """Draw panels of one part of the image with common colours, two in a row, at least one.

    Colours span what the last panel shows, without the outermost 0.5 % on either side. ``box`` is x0, y0, x1, y1 of the
    part, pixels; the outlines of ``outlined`` are drawn in all panels.
    """
    last = panels[-1]
    centres = np.array([last.mesh.nodes[cell[cell >= 0]].mean(axis=0) for cell in last.mesh.cells])
    shown = last.values[find_points_inside(centres, box)]
    low, high = np.nanpercentile(shown, [HIDDEN_PERCENT, 100 - HIDDEN_PERCENT])
    figure, all_axes = _page(len(panels), box)
    for axes, panel in zip(all_axes, panels, strict=True):
        cells = draw_cell_colours(axes, panel.mesh, panel.mesh.nodes, panel.values, (low, high))
        draw_outlines(axes, outlined)
        set_bounds(axes, box)
        axes.set_aspect("equal")
        axes.set(xlabel="x [px]", ylabel="y [px]")
        axes.set_title(panel.title, fontsize="medium")
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
