"""The deformed mesh with a displacement component in colour (Fig. 9 of [BP17])."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.io.result_reader import Result
from ddic.kinematics.strain import count_folded_cells, find_largest_gradient, project_rigid_motion_out
from ddic.mesh.mesh import Mesh
from ddic.plots import canvas
from ddic.plots.canvas import PIXELS, Bounds, Component, LengthUnit, Limits

VISIBLE_SHARE = 0.05
"""Largest displacement that is drawn, relative to the mesh, where cells bear it; a larger value exaggerates more."""

LARGEST_STRETCH = 0.5
"""Largest gradient of what is drawn: no cell is squeezed to less than the half. Below 1 no cell folds."""

MOST_CELLS_WITH_EDGES = 20_000
"""Cells up to which their edges are drawn; a larger value makes fine meshes black."""


@dataclass(frozen=True)
class SharedView:
    """How several results are drawn alike.

    Attributes
    ----------
    factor : float
        By which the displacement without its rigid motion is amplified, where the user asks for nothing else.
    bounds : (float, float, float, float)
        x0, y0, x1, y1 of the axes, in their unit.
    """

    factor: float
    bounds: Bounds


def choose_amplification(result: Result) -> float:
    """Choose an amplification, one digit, of the displacement without its rigid motion.

    It makes that 5 % of the mesh, or less where the largest gradient of the displacement would fold cells, and is at
    least 1. Raises InputError where no cell was measured.
    """
    mesh, displacement = _keep_measured(result)
    return _choose_factor(result, mesh, project_rigid_motion_out(mesh.nodes, displacement))


def _choose_factor(result: Result, mesh: Mesh, departure: NDArray[np.float64]) -> float:
    """An amplification of the displacement of the measured cells without its rigid motion."""
    largest = float(np.abs(departure).max())
    if largest == 0.0:
        return 1.0
    wanted = VISIBLE_SHARE * float(np.ptp(result.mesh.nodes, axis=0).max()) / largest
    limit = LARGEST_STRETCH / max(find_largest_gradient(mesh, departure), 1e-300)
    factor = float(f"{wanted:.0e}")
    return max(1.0, factor if factor <= limit else _round_down(limit))


def find_shared_view(results: Iterable[Result], amplification: float | None, unit: LengthUnit) -> SharedView:
    """Find a factor, the least among theirs, and axes that suit all of several results, each looked at once.

    ``amplification`` is that of the whole displacement, where the user asks for it. Raises InputError where no cell of
    one was measured.
    """
    factors, boxes, moves = [], [], []
    for result in results:
        mesh, displacement = _keep_measured(result)
        departure = project_rigid_motion_out(mesh.nodes, displacement)
        # What stands still looks alike by any factor.
        factors += [_choose_factor(result, mesh, departure)] if departure.any() else []
        shown = departure if amplification is None else displacement
        boxes.append((result.mesh.nodes.min(axis=0), result.mesh.nodes.max(axis=0)))
        moves.append((np.minimum(shown.min(axis=0), 0.0), np.maximum(shown.max(axis=0), 0.0)))
    factor = min(factors, default=1.0)
    scale = factor if amplification is None else amplification
    # Two opposite corners that no node passes, whichever moves farthest.
    corners = np.array(boxes) + scale * (np.array(moves) if scale >= 0 else np.array(moves)[:, ::-1])
    return SharedView(factor, canvas.find_mesh_bounds(unit.size * corners.reshape(-1, 2)))


def _keep_measured(result: Result) -> tuple[Mesh, NDArray[np.float64]]:
    """The cells whose nodes all were measured, and the displacement of their nodes, pixels."""
    cells = result.mesh.find_cells_among(result.measured_nodes)
    if not len(cells):
        raise InputError(f"{result.path}: no cell was measured, of which a deformed mesh could be drawn")
    if len(cells) == result.mesh.n_cells:
        return result.mesh, result.displacement
    mesh, node_ids = result.mesh.create_submesh(cells)
    return mesh, result.displacement[node_ids]


def _round_down(value: float) -> float:
    """The largest number of one digit that is not above a positive one."""
    power = 10.0 ** math.floor(math.log10(value))
    return math.floor(value / power) * power


def draw_deformed(result: Result, component: Component = "magnitude", amplification: float | None = None,
                  unit: LengthUnit = PIXELS, limits: Limits | None = None, shared: SharedView | None = None) -> Figure:
    """Draw the mesh moved by its amplified displacement, over the whole mesh at rest in grey.

    Cells with a node that was not measured are drawn at rest alone. ``amplification`` is of the whole displacement,
    rigid motion and all; where it is left out, one that shows the displacement without its rigid motion and folds no
    cell. ``shared`` is of several results that are drawn alike; where it is left out, what fits this one. ``limits`` of
    the colours are in the unit. Raises InputError where no cell was measured.
    """
    mesh, displacement = _keep_measured(result)
    rest = unit.size * result.mesh.nodes
    if amplification is None:
        departure = project_rigid_motion_out(mesh.nodes, displacement)
        factor = _choose_factor(result, mesh, departure) if shared is None else shared.factor
        moved = unit.size * (mesh.nodes + factor * departure)
        title = f"Deformed mesh without rigid motion, amplified {factor:g} times"
    else:
        moved = unit.size * (mesh.nodes + amplification * displacement)
        n_folded = count_folded_cells(mesh, moved)
        folded = f"; {n_folded} cells are folded" if n_folded else ""
        title = f"Deformed mesh, displacement amplified {amplification:g} times{folded}"
    bounds = canvas.find_mesh_bounds(np.concatenate([rest, moved])) if shared is None else shared.bounds
    figure, axes = canvas.make_image_figure(bounds, title, unit)
    at_rest = canvas.make_cell_polygons(result.mesh, rest, facecolors="0.9", edgecolors="0.9", linewidths=0.3)
    axes.add_collection(at_rest)
    values = unit.size * canvas.pick_component(displacement, component)
    colours = canvas.draw_nodal_colours(axes, mesh, moved, values, canvas.choose_limits(values, limits))
    if mesh.n_cells <= MOST_CELLS_WITH_EDGES:
        edges = canvas.make_cell_polygons(mesh, moved, facecolors="none", edgecolors="black", linewidths=0.15,
                                          rasterized=mesh.n_cells > canvas.MOST_SHARP_CELLS)
        axes.add_collection(edges)
    canvas.add_colour_bar(figure, axes, colours, canvas.label_component("u", component, unit))
    return figure
