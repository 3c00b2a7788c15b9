"""What the figures share: axes in image coordinates, colour bars, saving."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection, TriMesh
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, ScalarFormatter
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from ddic.io.plots.length_unit import PIXELS, LengthUnit
from ddic.io.plots.page_text import format_title
from ddic.io.replace_on_exit import NewFiles, begin_files
from ddic.mesh.mesh import Mesh

Component = Literal["x", "y", "magnitude"]
COMPONENTS: tuple[Component, ...] = ("x", "y", "magnitude")
COLOURS = "viridis"

DPI = 150
"""Dots an inch of a saved page; a larger value gives larger files."""

WIDTH_INCHES = 7.0
"""Width of a page."""

NARROWEST_INCHES = 3.8
"""Least width of a page; a larger value leaves more room for titles over tall meshes."""

TALLEST_INCHES = 8.0
"""Most height of the axes."""

LEFT_INCHES, RIGHT_INCHES = 0.85, 1.15
"""Beside the axes: numbers and label of y; the colour bar with its own."""

BELOW_INCHES = 0.6
"""Below the axes: numbers and label of x."""

ABOVE_INCHES = 0.25
"""Above the axes, beside the title's lines."""

WIDE = 0.55
"""Height over width of panels below which they stand above one another."""

MOST_COLUMNS = 3
"""Panels side by side."""

PANEL_INCHES = 4.4
"""Width of one of several panels side by side."""

INCHES_A_NUMBER = 0.6
"""Room for a number at an axis; a larger value writes fewer."""

LINE_INCHES = 0.22
"""Height of a line of a title."""

SHORTEST_BAR_INCHES = 1.3
"""Least height of a colour bar, beside meshes that are flat."""

BAR_INCHES, GAP_INCHES = 0.16, 0.12
"""Width of a colour bar, and what lies between it and the axes."""

TITLE_POINTS = 11.0
"""Size of a title's type."""

MOST_SHARP_CELLS = 10_000
"""Cells up to which they are drawn as lines and faces in PDF and SVG; a larger value makes larger files. Others are
drawn as pixels."""

Bounds = tuple[float, float, float, float]
Limits = tuple[float, float]


def make_image_figure(bounds: Bounds, title: str, unit: LengthUnit = PIXELS, *,
                      beside: float = RIGHT_INCHES) -> tuple[Figure, Axes]:
    """Make a figure whose axes are those of the image: equal scales, y down.

    Parameters
    ----------
    bounds : (float, float, float, float)
        x0, y0, x1, y1, in the unit.
    title : str
        Above the axes; broken into lines where it is wider than the page.
    unit : LengthUnit, optional
        Of both axes.
    beside : float, optional
        Room to the right of the axes, inches; that of a colour bar by default.

    Returns
    -------
    figure : Figure
        The page, just as large as what is on it.
    axes : Axes
        Empty axes.
    """
    figure, (axes,) = make_panels([bounds], [title], unit, beside=beside)
    return figure, axes


def make_panels(boxes: Sequence[Bounds], titles: Sequence[str], unit: LengthUnit = PIXELS, *,
                beside: float = RIGHT_INCHES) -> tuple[Figure, list[Axes]]:
    """Make a figure of several panels of one size, each as ``make_image_figure`` makes its one.

    Parameters
    ----------
    boxes : sequence of (float, float, float, float)
        x0, y0, x1, y1 of each, in the unit; the first tells the size of all.
    titles : sequence of str
        Of each.
    unit : LengthUnit, optional
        Of all axes.
    beside : float, optional
        Room to the right of each, inches.

    Returns
    -------
    figure : Figure
        Panels side by side, or above one another where they are wide.
    panels : list of Axes
        Empty axes.
    """
    x0, y0, x1, y1 = boxes[0]
    ratio = (y1 - y0) / max(x1 - x0, 1e-300)
    n_columns = 1 if ratio < WIDE else min(len(boxes), MOST_COLUMNS)
    n_rows = math.ceil(len(boxes) / n_columns)
    widest = (WIDTH_INCHES if n_columns == 1 else PANEL_INCHES) - LEFT_INCHES - beside
    height = min(widest * ratio, TALLEST_INCHES / n_rows)
    width = height / ratio
    panel_width = max(width + LEFT_INCHES + beside, NARROWEST_INCHES)
    wrapped = [format_title(title, panel_width - 2 * GAP_INCHES, TITLE_POINTS) for title in titles]
    above = ABOVE_INCHES + LINE_INCHES * max(text.count("\n") + 1 for text in wrapped)
    panel_height = max(height, SHORTEST_BAR_INCHES) + above + BELOW_INCHES
    page = np.array([n_columns * panel_width, n_rows * panel_height])
    # In the middle of what a page with a long title or a short mesh leaves.
    left = LEFT_INCHES + 0.5 * (panel_width - width - LEFT_INCHES - beside)
    below = BELOW_INCHES + 0.5 * (panel_height - height - above - BELOW_INCHES)
    figure = Figure(figsize=(float(page[0]), float(page[1])))
    panels = []
    for k, (box, title) in enumerate(zip(boxes, wrapped, strict=True)):
        row, column = divmod(k, n_columns)
        corner = np.array([column * panel_width + left, (n_rows - 1 - row) * panel_height + below])
        axes = figure.add_axes((*(corner / page), width / page[0], height / page[1]))
        _set_up_axes(axes, box, unit, (width, height))
        # In the middle of the panel, not of the axes, which have more on their right than on their left.
        axes.set_title(title, fontsize=TITLE_POINTS, x=(0.5 * panel_width - left) / width)
        panels.append(axes)
    return figure, panels


def _set_up_axes(axes: Axes, bounds: Bounds, unit: LengthUnit, size: tuple[float, float]) -> None:
    """Limits, labels and as many numbers as there is room for; size: width and height of the axes, inches."""
    set_bounds(axes, bounds)
    axes.set_aspect("equal")
    axes.set_xlabel(f"x [{unit.name}]")
    axes.set_ylabel(f"y [{unit.name}]")
    for axis, length in zip((axes.xaxis, axes.yaxis), size, strict=True):
        n_numbers = max(2, min(7, int(length / INCHES_A_NUMBER)))
        axis.set_major_locator(MaxNLocator(nbins=n_numbers, steps=[1, 2, 5, 10]))


def set_bounds(axes: Axes, bounds: Bounds) -> None:
    """Set what axes show, y down: once more after an image was drawn, which moves their limits to its own.

    Parameters
    ----------
    axes : Axes
        In image coordinates.
    bounds : (float, float, float, float)
        x0, y0, x1, y1, in the axes' unit.
    """
    x0, y0, x1, y1 = bounds
    axes.set_xlim(x0, x1)
    axes.set_ylim(y1, y0)


def find_mesh_bounds(nodes: NDArray[np.float64], margin: float = 0.03) -> Bounds:
    """Find the box around nodes.

    Parameters
    ----------
    nodes : (n, 2) array
        Pixels.
    margin : float, optional
        Relative to the box's longer side.

    Returns
    -------
    (float, float, float, float)
        x0, y0, x1, y1, pixels.
    """
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    gap = margin * float((high - low).max())
    x0, y0 = low - gap
    x1, y1 = high + gap
    return float(x0), float(y0), float(x1), float(y1)


def add_colour_bar(figure: Figure, axes: Axes, mappable: Any, label: str) -> None:
    """Add a labelled colour bar as high as the axes, or higher where they are flat.

    Parameters
    ----------
    figure : Figure
        The page.
    axes : Axes
        Beside which it stands.
    mappable : object
        What is in colour.
    label : str
        With its unit.
    """
    width, height = axes.get_position().size * figure.get_size_inches()
    share = max(1.0, SHORTEST_BAR_INCHES / height)
    # x, y, width, height, of the axes'.
    beside = axes.inset_axes((1.0 + GAP_INCHES / width, 0.5 - 0.5 * share, BAR_INCHES / width, share))
    bar = figure.colorbar(mappable, cax=beside, label=label, extend=_find_values_beyond(mappable))
    # Strains are written times a power of ten: their zeros would need the room of the label.
    numbers = ScalarFormatter(useMathText=True)
    numbers.set_powerlimits((-2, 4))
    bar.ax.yaxis.set_major_formatter(numbers)
    bar.ax.yaxis.set_offset_position("left")


def _find_values_beyond(mappable: Any) -> Literal["neither", "min", "max", "both"]:
    """Sides of the colours on which there are values beyond, as matplotlib calls them: the bar has arrows there."""
    # Masked where an image has no value; comparisons with nan are false.
    values: NDArray[np.float64] = np.ma.getdata(mappable.get_array())  # type: ignore[no-untyped-call]
    low, high = mappable.get_clim()
    below, above = bool((values < low).any()), bool((values > high).any())
    return "both" if below and above else "min" if below else "max" if above else "neither"


def choose_limits(values: NDArray[np.float64], asked: Limits | None = None) -> Limits:
    """Choose where colours begin and end.

    Parameters
    ----------
    values : (n,) array
        What is in colour; nan is not.
    asked : (float, float), optional
        What the user wants; all values are spanned where it is left out.

    Returns
    -------
    (float, float)
        Of the values' unit.
    """
    if asked is not None:
        return asked
    finite = values[np.isfinite(values)]
    if not finite.size:
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    # Colours of one value need a span; it is as wide as rounding would make it.
    return (low, high) if low < high else (low - max(abs(low), 1e-12) * 1e-6, high + max(abs(high), 1e-12) * 1e-6)


def make_cell_polygons(mesh: Mesh, nodes: NDArray[np.float64], **style: Any) -> PolyCollection:
    """Make polygons of the cells.

    Parameters
    ----------
    mesh : Mesh
        The cells.
    nodes : (n_nodes, 2) array
        Where they are drawn, pixels.
    **style : object
        As matplotlib's collections take it.

    Returns
    -------
    PolyCollection
        A polygon a cell.
    """
    nodes_of_cells = np.split(mesh.connectivity, mesh.offsets[1:-1])
    corners = [nodes[of_cell] for of_cell in nodes_of_cells]
    return PolyCollection(corners, **style)


def draw_nodal_colours(axes: Axes, mesh: Mesh, nodes: NDArray[np.float64], values: NDArray[np.float64],
                       limits: Limits) -> TriMesh:
    """Draw values at nodes in colour, interpolated; nothing where a cell has a node without one.

    Parameters
    ----------
    axes : Axes
        Where they are drawn.
    mesh : Mesh
        The cells.
    nodes : (n_nodes, 2) array
        Where they are drawn, in the unit of the axes.
    values : (n_nodes,) array
        Of any unit; nan where there is none.
    limits : (float, float)
        Of the colours.

    Returns
    -------
    TriMesh
        For the colour bar.
    """
    shown = np.zeros(mesh.n_cells, dtype=bool)
    shown[mesh.find_cells_among(np.isfinite(values))] = True
    of_cells = [block.cells for block in mesh.cell_blocks for _ in block.type.triangles]
    triangulation = make_triangulation(mesh, nodes)
    triangulation.set_mask(~shown[np.concatenate(of_cells)])
    colours: TriMesh = axes.tripcolor(triangulation, values, shading="gouraud", cmap=COLOURS, vmin=limits[0],
                                      vmax=limits[1], rasterized=True)
    return colours


def make_triangulation(mesh: Mesh, nodes: NDArray[np.float64]) -> Triangulation:
    """Cut the cells into triangles.

    Parameters
    ----------
    mesh : Mesh
        The cells.
    nodes : (n_nodes, 2) array
        Where they are drawn, pixels.

    Returns
    -------
    Triangulation
        On all nodes.
    """
    triangles = [block.nodes[:, corners] for block in mesh.cell_blocks for corners in block.type.triangles]
    return Triangulation(nodes[:, 0], nodes[:, 1], np.concatenate(triangles))


def pick_component(vectors: NDArray[np.float64], component: Component) -> NDArray[np.float64]:
    """Pick one component of vectors, or their length.

    Parameters
    ----------
    vectors : (n, 2) array
        Of any unit.
    component : {"x", "y", "magnitude"}
        Which.

    Returns
    -------
    (n,) array
        Of the same unit.
    """
    if component == "magnitude":
        return np.asarray(np.hypot(vectors[:, 0], vectors[:, 1]))
    axis = 0 if component == "x" else 1
    return vectors[:, axis]


def format_component(symbol: str, component: Component) -> str:
    """Write a component of a vector as a label does.

    Parameters
    ----------
    symbol : str
        Of the vector.
    component : {"x", "y", "magnitude"}
        Which.

    Returns
    -------
    str
        TeX.
    """
    return f"$|{symbol}|$" if component == "magnitude" else f"${symbol}_{component}$"


def save_figure(figure: Figure, path: Path, dpi: int = DPI, files: NewFiles | None = None) -> None:
    """Save a figure.

    Parameters
    ----------
    figure : Figure
        The page.
    path : Path
        Whose ending tells the format: png, pdf, svg.
    dpi : int, optional
        Dots an inch; in PDF and SVG of images and of fields in colour, beside which texts and lines stay sharp.
    files : NewFiles, optional
        With which it takes its name; by default it does so by itself.

    Raises
    ------
    InputError, OSError
        Where it cannot be written; an earlier one stays.
    """
    ending = path.suffix.lower()
    # Journals refuse type 3, matplotlib's own choice; without a date the same picture is the same file.
    with rc_context({"pdf.fonttype": 42, "svg.hashsalt": path.stem}):
        dated = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
        with begin_files(files) as new:
            figure.savefig(new.begin(path), format=ending.removeprefix("."), dpi=dpi, metadata=dated.get(ending))
