"""A value at the nodes or on the cells in colour, over the reference image where there is one.

Maps of displacement, also around near fields (Fig. 4 of [BP17]), of strain and of the difference between two measured
fields (Fig. 10), and an image thinned out to what a figure can show. Limits of colours are in the unit that is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.images.source import ImageSource
from ddic.images.window import Window
from ddic.io import result_schema as schema
from ddic.io.result_reader import Result, displacement_at
from ddic.kinematics.strain import compute_hencky, compute_von_mises_strain, find_principal_strains
from ddic.mesh.interpolation import locate
from ddic.mesh.mesh import Mesh
from ddic.mesh.topology import find_boundary_facets
from ddic.plots import canvas
from ddic.plots.canvas import PIXELS, Bounds, Component, LengthUnit, Limits

Array = NDArray[np.float64]


def draw_difference(result: Result, other: Result, component: Component = "magnitude", unit: LengthUnit = PIXELS,
                    limits: Limits | None = None) -> Figure:
    """Draw a result's displacement minus another's, interpolated to its nodes; nothing where either is unmeasured."""
    mesh, nodes = result.mesh, unit.size * result.mesh.nodes
    difference = unit.size * (result.displacement - _interpolate(other, mesh.nodes))
    squares = np.sum(difference**2, axis=1)
    is_known = np.isfinite(squares)
    rms = float(np.sqrt(squares[is_known].mean())) if is_known.any() else np.nan
    title = f"{result.path.name} minus {other.path.name}, RMS {rms:.2e} {unit.name}"
    figure, axes = canvas.make_image_figure(canvas.find_mesh_bounds(nodes), title, unit)
    values = canvas.pick_component(difference, component)
    colours = canvas.draw_nodal_colours(axes, mesh, nodes, values, canvas.choose_limits(values, limits))
    canvas.add_colour_bar(figure, axes, colours, canvas.label_component(r"\Delta u", component, unit))
    return figure


def _interpolate(result: Result, points: Array) -> Array:
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
        axes.imshow(self.pixels, cmap="gray", interpolation="nearest", rasterized=True,
                    zorder=0 if opacity == 1.0 else OVER_ALL, alpha=opacity,
                    extent=find_thinned_extent(self.pixels.shape, self.step, size))

    def clip(self, bounds: Bounds, size: float = 1.0) -> Bounds:
        """Find the part of a box that lies in the image, whose pixels reach half a pixel beyond their centres.

        The box is x0, y0, x1, y1 in the axes' unit, ``size`` a pixel's in that unit.
        """
        x0, y0, x1, y1 = bounds
        return (max(x0, -0.5 * size), max(y0, -0.5 * size), min(x1, (self.width - 0.5) * size),
                min(y1, (self.height - 0.5) * size))


def make_figure_over(image: Preview | None, bounds: Bounds, title: str, unit: LengthUnit = PIXELS,
                     beside: float = canvas.RIGHT_INCHES) -> tuple[Figure, Axes]:
    """Make a figure as ``make_image_figure`` does, over the image where it is given, whose edges cut the bounds."""
    if image is None:
        return canvas.make_image_figure(bounds, title, unit, beside=beside)
    bounds = image.clip(bounds, unit.size)
    figure, axes = canvas.make_image_figure(bounds, title, unit, beside=beside)
    image.draw(axes, unit.size)
    canvas.set_bounds(axes, bounds)
    return figure, axes


def read_preview(source: ImageSource) -> Preview:
    """Read an image row by row and keep at most 2000 pixels a side, thinned out evenly."""
    step = -(-max(source.width, source.height) // LARGEST_SIDE)
    if step == 1:
        pixels = source.read(Window(0, 0, source.width, source.height))
    else:
        bands = range(0, source.height, 64 * step)
        pixels = np.concatenate([
            source.read(Window(0, y, source.width, min(y + 64 * step, source.height)))[::step, ::step]
            for y in bands])
    return Preview(pixels, step, source.width, source.height)


def find_thinned_extent(shape: tuple[int, ...], step: int, size: float) -> tuple[float, float, float, float]:
    """Find left, right, bottom, top of a thinned image, y down, in the axes' unit; ``size`` is a pixel's."""
    return (size * (-0.5 * step), size * ((shape[1] - 0.5) * step), size * ((shape[0] - 0.5) * step),
            size * (-0.5 * step))


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
    """

    title: str
    label: str
    values: Array
    by_cell: bool = False


def draw_displacement(result: Result, image: Preview | None = None, component: Component = "magnitude",
                      unit: LengthUnit = PIXELS, limits: Limits | None = None) -> Figure:
    """Draw the displacement on the mesh at rest, over the reference image where it is given."""
    shown = Values(f"Displacement {canvas.format_component('u', component)}",
                   canvas.label_component("u", component, unit),
                   unit.size * canvas.pick_component(result.displacement, component))
    return draw_values(result.mesh, [shown], image, unit, [limits])


def draw_values(mesh: Mesh, shown: Sequence[Values], image: Preview | None, unit: LengthUnit,
                limits: Sequence[Limits | None]) -> Figure:
    """Draw panels of values on one mesh, over the image where it is given.

    ``limits`` are those of the colours of each panel; where they are None its values tell them.
    """
    nodes = unit.size * mesh.nodes
    bounds = canvas.find_mesh_bounds(nodes, MARGIN)
    if image is not None:
        bounds = image.clip(bounds, unit.size)
    figure, panels = canvas.make_panels([bounds] * len(shown), [panel.title for panel in shown], unit)
    for axes, panel, asked in zip(panels, shown, limits, strict=True):
        draw = canvas.draw_cell_colours if panel.by_cell else canvas.draw_nodal_colours
        colours = draw(axes, mesh, nodes, panel.values, canvas.choose_limits(panel.values, asked))
        if image is not None:
            # The image once more, thinly, and not colours thinly over it: those of triangles would show their edges.
            image.draw(axes, unit.size)
            image.draw(axes, unit.size, opacity=1.0 - OPACITY)
            canvas.set_bounds(axes, bounds)
        canvas.add_colour_bar(figure, axes, colours, panel.label)
    return figure


AROUND = 0.12
"""Around a near field, relative to its longer side."""


def draw_near_far(result: Result, component: Component = "magnitude", unit: LengthUnit = PIXELS) -> Figure:
    """Draw the displacement of the whole mesh, then around each near field in colours of its own.

    Near fields are outlined; titles tell alpha, in pixels, by which each near set-up moved.
    """
    whole = replace(result.mesh, nodes=unit.size * result.mesh.nodes)
    camera_of_cell = result.cell_data[schema.CAMERA]
    titles, boxes, near = ["far field"], [canvas.find_mesh_bounds(whole.nodes)], []
    for camera in range(1, int(camera_of_cell.max()) + 1):
        mesh, _ = whole.create_submesh(np.flatnonzero(camera_of_cell == camera))
        alpha = result.attributes[schema.near_group(camera)]["alpha_px"]
        titles.append(f"near field {camera}, $\\alpha$ = ({alpha[0]:.3f}, {alpha[1]:.3f}) px")
        boxes.append(canvas.find_mesh_bounds(mesh.nodes, AROUND))
        near.append(mesh)
    figure, panels = canvas.make_panels(boxes, titles, unit)
    values = unit.size * canvas.pick_component(result.displacement, component)
    for axes, box in zip(panels, boxes, strict=True):
        inside = values[find_points_inside(whole.nodes, box)]
        colours = canvas.draw_nodal_colours(axes, whole, whole.nodes, values, canvas.choose_limits(inside))
        draw_outlines(axes, near)
        canvas.set_bounds(axes, box)
        canvas.add_colour_bar(figure, axes, colours, canvas.label_component("u", component, unit))
    return figure


def draw_outlines(axes: Axes, outlined: Sequence[Mesh]) -> None:
    """Draw the outlines of meshes, on grey."""
    for mesh in outlined:
        edges = find_boundary_facets(mesh)[:, :2]
        axes.add_collection(LineCollection(list(mesh.nodes[edges]), colors="white", linewidths=1.2))
    axes.set_facecolor("0.6")


def find_points_inside(points: Array, box: Bounds) -> NDArray[np.bool_]:
    """Tell which points (n, 2) lie in a box, (n,)."""
    low, high = box[:2], box[2:]
    is_inside = (points >= low) & (points <= high)
    return np.asarray(is_inside.all(axis=1))


Measure = Literal["infinitesimal", "green-lagrange", "hencky"]
NUMBERS = ("xx", "yy", "xy", "principal-1", "principal-2", "von-mises")
"""What of a tensor is drawn."""

PANELS = ("xx", "yy", "xy")
"""What is drawn where nothing is asked for."""

NAMES = {"infinitesimal": "Strain", "green-lagrange": "Green-Lagrange strain", "hencky": "Logarithmic strain"}
SYMBOLS = {"xx": "xx", "yy": "yy", "xy": "xy", "principal-1": "1", "principal-2": "2", "von-mises": "vM"}


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


def draw_strain(result: Result, choice: StrainChoice, unit: LengthUnit = PIXELS, limits: Limits | None = None,
                of_panels: Sequence[Limits] | None = None, image: Preview | None = None) -> Figure:
    """Draw strain on the mesh at rest, in one panel or three, over the image where it is given.

    ``of_panels`` are limits of the colours of each panel, in place of ``limits``. Raises InputError where the result
    has no strain at nodes.
    """
    panels = list_strain_panels(result, choice)
    return draw_values(result.mesh, panels, image, unit, of_panels or [limits] * len(panels))


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


def pick_tensors(result: Result, choice: StrainChoice) -> Array:
    """Pick the strain tensors xx, yy, xy of a result, (n_nodes, 3) or (n_cells, 3).

    Raises InputError where the result has no strain at nodes.
    """
    if choice.by_cell:
        name = schema.STRAIN_INFINITESIMAL if choice.measure == "infinitesimal" else schema.STRAIN_GREEN_LAGRANGE
        tensors = schema.pick_in_the_plane(result.cell_data[name])
        return compute_hencky(tensors) if choice.measure == "hencky" else tensors
    name = schema.NODAL_STRAINS[choice.measure]
    if name not in result.point_data:
        raise InputError(f"{result.path}: holds no strain at nodes (written before schema 1.6); add --by-cell, or run "
                         "ddic again")
    return schema.pick_in_the_plane(result.point_data[name])


def pick_number(tensors: Array, number: str) -> Array:
    """Pick a component, a principal value or the equivalent strain, one of NUMBERS, of tensors xx, yy, xy, (n, 3)."""
    if number in PANELS:
        return tensors[:, PANELS.index(number)]
    if number == "von-mises":
        return compute_von_mises_strain(tensors)
    return find_principal_strains(tensors)[:, 0 if number == "principal-1" else 1]
