"""A value at the nodes or on the cells in colour, over the reference image where there is one.

Maps of displacement, of strain and of the difference between two measured fields (Fig. 10 of [BP17]), and an image
thinned out to what a figure can show. Limits of colours are in the unit that is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import Collection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.images.source import ImageSource
from ddic.io import result_schema as schema
from ddic.io.result_reader import Result, displacement_at
from ddic.kinematics.strain import compute_hencky, compute_von_mises_strain, find_principal_strains
from ddic.mesh.interpolation import locate
from ddic.mesh.mesh import Mesh
from ddic.plots.canvas import (
    COLOURS,
    MOST_SHARP_CELLS,
    PIXELS,
    Component,
    LengthUnit,
    Limits,
    add_colour_bar,
    choose_limits,
    draw_nodal_colours,
    find_mesh_bounds,
    format_component,
    make_cell_polygons,
    make_image_figure,
    make_panels,
    pick_component,
    set_bounds,
)


def draw_difference(result: Result, other: Result, component: Component = "magnitude", unit: LengthUnit = PIXELS,
                    limits: Limits | None = None) -> Figure:
    """Draw a result's displacement minus another's, interpolated to its nodes; nothing where either is unmeasured."""
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


LARGEST_SIDE = 2000

OVER_ALL = 2.5
"""Above matplotlib's patches and lines, below its texts."""


@dataclass(frozen=True)
class Preview:
    """An image with every ``step``-th pixel.

    Attributes
    ----------
    pixels : (rows, columns) array
        Grey levels.
    step : int
        Pixels from one to the next.
    width, height : int
        Of the whole image, pixels.
    """

    pixels: NDArray[Any]
    step: int
    width: int
    height: int

    def draw(self, axes: Axes, size: float = 1.0, opacity: float = 1.0) -> None:
        """Draw in grey, pixel centres at integers; ``size`` is a pixel's in the axes' unit.

        Below an ``opacity`` of 1 it is drawn over everything that is there.
        """
        left, right, bottom, top = find_thinned_extent(self.pixels.shape, self.step)
        axes.imshow(self.pixels, cmap="gray", interpolation="nearest", rasterized=True,
                    zorder=0 if opacity == 1.0 else OVER_ALL, alpha=opacity,
                    extent=(size * left, size * right, size * bottom, size * top))

    def clip(self, bounds: tuple[float, float, float, float], size: float = 1.0) -> tuple[float, float, float, float]:
        """Find the part of a box that lies in the image, whose pixels reach half a pixel beyond their centres.

        The box is x0, y0, x1, y1 in the axes' unit, ``size`` a pixel's in that unit.
        """
        x0, y0, x1, y1 = bounds
        return (max(x0, -0.5 * size), max(y0, -0.5 * size), min(x1, (self.width - 0.5) * size),
                min(y1, (self.height - 0.5) * size))


def read_preview(source: ImageSource) -> Preview:
    """Read an image row by row and keep at most 2000 pixels a side, thinned out evenly."""
    step = -(-max(source.width, source.height) // LARGEST_SIDE)
    if step == 1:
        pixels = source.read(source.extent)
    else:
        pixels = np.concatenate([source.read(rows)[::step, ::step] for rows in source.extent.split_rows(64 * step)])
    return Preview(pixels, step, source.width, source.height)


def find_thinned_extent(shape: tuple[int, ...], step: int) -> tuple[float, float, float, float]:
    """Find left, right, bottom, top of a thinned image, pixels, y down."""
    return (-0.5 * step, (shape[1] - 0.5) * step, (shape[0] - 0.5) * step, -0.5 * step)


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
    """Draw the displacement on the mesh at rest, over the reference image where it is given."""
    symbol = format_component("u", component)
    shown = Values(f"Displacement {symbol}", f"{symbol} [{unit.name}]",
                   unit.size * pick_component(result.displacement, component))
    return draw_values(result.mesh, [shown], image, unit, limits)


def draw_values(mesh: Mesh, shown: Sequence[Values], image: Preview | None, unit: LengthUnit,
                limits: Limits | None) -> Figure:
    """Draw panels of values on one mesh, over the image where it is given.

    ``limits`` are those of the colours of all panels that have none of their own; a panel's values tell them where that
    is None too.
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


Measure = Literal["infinitesimal", "green-lagrange", "hencky"]
MEASURES: tuple[Measure, ...] = ("infinitesimal", "green-lagrange", "hencky")
NUMBERS = ("xx", "yy", "xy", "principal-1", "principal-2", "von-mises")
"""What of a tensor is drawn."""

PANELS = ("xx", "yy", "xy")
"""What is drawn where nothing is asked for."""

NAMES = {"infinitesimal": "Strain", "green-lagrange": "Green-Lagrange strain", "hencky": "Logarithmic strain"}
SYMBOLS = {"xx": "xx", "yy": "yy", "xy": "xy", "principal-1": "1", "principal-2": "2", "von-mises": "vM"}
IN_THE_PLANE = [0, 1, 3]
"""Of XX, YY, ZZ, XY, YZ, XZ."""


@dataclass(frozen=True)
class StrainChoice:
    """Which strain is drawn.

    Attributes
    ----------
    measure : {"infinitesimal", "green-lagrange", "hencky"}
        The tensor.
    number : str or None
        One of NUMBERS; None for a panel each of xx, yy and xy.
    by_cell : bool
        As it was computed in the middle of cells, not as it was recovered at nodes.
    """

    measure: Measure = "infinitesimal"
    number: str | None = None
    by_cell: bool = False


def draw_strain(result: Result, choice: StrainChoice, unit: LengthUnit = PIXELS,
                limits: Limits | None = None, of_panels: Sequence[Limits] | None = None,
                image: Preview | None = None) -> Figure:
    """Draw strain on the mesh at rest, in one panel or three, over the image where it is given.

    ``of_panels`` are limits of the colours of each panel, in place of ``limits``. Raises InputError where the result
    has no strain at nodes.
    """
    panels = list_strain_panels(result, choice)
    if of_panels is not None:
        panels = [replace(panel, limits=own) for panel, own in zip(panels, of_panels, strict=True)]
    return draw_values(result.mesh, panels, image, unit, limits)


def list_strain_panels(result: Result, choice: StrainChoice) -> list[Values]:
    """List what the panels of a strain map show, one or three.

    Raises InputError where the result has no strain at nodes.
    """
    tensors = pick_tensors(result, choice)
    numbers = PANELS if choice.number is None else (choice.number,)
    symbol = "E" if choice.measure == "green-lagrange" else r"\varepsilon"
    where = ", by cell" if choice.by_cell else ""
    panels = []
    for number in numbers:
        written = f"${symbol}_{{{SYMBOLS[number]}}}$"
        panels.append(Values(f"{NAMES[choice.measure]} {written}{where}", f"{written} [-]",
                             pick_number(tensors, number), choice.by_cell))
    return panels


def pick_tensors(result: Result, choice: StrainChoice) -> NDArray[np.float64]:
    """Pick the strain tensors xx, yy, xy of a result, (n_nodes, 3) or (n_cells, 3).

    Raises InputError where the result has no strain at nodes.
    """
    if choice.by_cell:
        name = schema.STRAIN_INFINITESIMAL if choice.measure == "infinitesimal" else schema.STRAIN_GREEN_LAGRANGE
        tensors: NDArray[np.float64] = result.cell_data[name][:, IN_THE_PLANE]
        return compute_hencky(tensors) if choice.measure == "hencky" else tensors
    name = {"infinitesimal": schema.NODAL_INFINITESIMAL, "green-lagrange": schema.NODAL_GREEN_LAGRANGE,
            "hencky": schema.NODAL_HENCKY}[choice.measure]
    if name not in result.point_data:
        raise InputError(f"{result.path}: holds no strain at nodes (written before schema 1.6); add --by-cell, or run "
                         "ddic again")
    at_nodes: NDArray[np.float64] = result.point_data[name][:, IN_THE_PLANE]
    return at_nodes


def pick_number(tensors: NDArray[np.float64], number: str) -> NDArray[np.float64]:
    """Pick a component, a principal value or the equivalent strain, one of NUMBERS, of tensors xx, yy, xy, (n, 3)."""
    if number in PANELS:
        return tensors[:, PANELS.index(number)]
    if number == "von-mises":
        return compute_von_mises_strain(tensors)
    return find_principal_strains(tensors)[:, 0 if number == "principal-1" else 1]
