"""What the figures share: axes in image coordinates, the image below, colours of nodes and cells, bars, saving.

Titles are broken so that they fit. Colours begin and end at percentiles of the values, which the colour bar says: a few
bad cells do not hide a field. Lengths are in pixels, or in the case's length unit where a pixel's is known. Pages grow
above what is on them already: for which frame of a series they show, and for a mark on pictures of fields that did not
converge, so that none is taken for a result. Places on a picture have numbered marks.
"""

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection, TriMesh
from matplotlib.colors import Colormap
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator, ScalarFormatter
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from ddic.arrays import Array
from ddic.errors import InputError
from ddic.io import result_schema as schema
from ddic.io.replace_on_exit import NewFiles, begin_files
from ddic.io.result_reader import Result
from ddic.mesh.mesh import Mesh

POINTS_AN_INCH = 72.0

CHARACTER = 0.62
"""Mean width of a character of a title relative to its size; a larger value breaks lines earlier."""


def format_title(text: str, width: float, size: float) -> str:
    """Break a title into lines that fit a width, inches, in type of a size, points; TeX in it has no blank."""
    n_characters = max(8, int(width * POINTS_AN_INCH / (CHARACTER * size)))
    return "\n".join(textwrap.wrap(text, n_characters, break_on_hyphens=False))


def make_room_above(figure: Figure, room: float) -> float:
    """Let a page grow by some room, inches, above what is on it, which keeps its size; return its new height."""
    width, height = figure.get_size_inches()
    share = float(height / (height + room))
    layout = figure.get_layout_engine()
    if layout is not None:
        layout.set(rect=(0.0, 0.0, 1.0, share))  # type: ignore[call-arg]  # that of the engines on which axes are packed
        if figure.get_suptitle():
            figure.suptitle(figure.get_suptitle(), y=0.98 * share)
    else:
        for axes in figure.axes:
            x, y, w, h = axes.get_position(original=True).bounds
            axes.set_position((x, y * share, w, h * share))
    figure.set_size_inches(width, height + room)
    return float(height + room)


@dataclass(frozen=True)
class LengthUnit:
    """A unit of lengths.

    Attributes
    ----------
    size : float
        Of a pixel, in this unit.
    name : str
        As labels have it.
    """

    size: float = 1.0
    name: str = "px"


PIXELS = LengthUnit()


def find_length_unit(result: Result, asked: str | None = None) -> LengthUnit:
    """Find the unit in which a result is drawn.

    ``asked`` is ``px`` or ``physical``; where it is left out, physical if the size of a pixel is known. Raises
    InputError where the case's unit is asked for and the result has none.
    """
    known = schema.DISPLACEMENT_PHYSICAL in result.point_data
    if asked == "physical" and not known:
        raise InputError(f"{result.path}: --units physical: measured without images.pixel_size, or volumes.voxel_size; "
                         "give it in the case and run again, or draw in px")
    if asked == "px" or not known:
        return PIXELS
    units = result.attributes[schema.UNITS]
    return LengthUnit(float(units["pixel_size"]), str(units["length_unit"]))


Component = Literal["x", "y", "z", "magnitude"]
COLOURS = "viridis"

DPI = 150
"""Dots an inch of a saved page; a larger value gives larger files."""

WIDTH_INCHES = 7.0
"""Width of a page."""

NARROWEST_INCHES = 3.8
"""Least width of a page; a larger value leaves more room for titles over tall meshes."""

TALLEST_INCHES = 8.0
"""Most height of the axes."""

LEFT_INCHES, RIGHT_INCHES = 0.85, 1.35
"""Beside the axes: numbers and label of y; the colour bar with its own, and what its limits are."""

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

PERCENTILES = (2.0, 98.0)
"""Of the values, where colours begin and end: values beyond have the colours of the ends, and the bar has arrows."""


@dataclass(frozen=True)
class ColourScale:
    """How values become colours.

    Attributes
    ----------
    limits : (float, float) or None
        Where colours begin and end; where it is None, at percentiles of the values.
    percentiles : (float, float)
        Of the values.
    palette : str or None
        Name of matplotlib's colour map; None for that of what is drawn.
    note : str
        What the colour bar says of limits that are given.
    """

    limits: Limits | None = None
    percentiles: tuple[float, float] = PERCENTILES
    palette: str | None = None
    note: str = ""

    def find_limits(self, values: Array) -> Limits:
        """Find where colours of values (n,) begin and end; those that are nan do not count."""
        if self.limits is not None:
            return self.limits
        finite = values[np.isfinite(values)]
        if not finite.size:
            return 0.0, 1.0
        low, high = np.percentile(finite, self.percentiles).tolist()
        # Colours of one value need a span; it is as wide as rounding would make it.
        return (low, high) if low < high else (low - max(abs(low), 1e-12) * 1e-6, high + max(abs(high), 1e-12) * 1e-6)

    def format_label(self, text: str) -> str:
        """Label a colour bar: what is drawn, with its unit, and below it which values have colours of their own."""
        low, high = self.percentiles
        is_stated = self.limits is None and (low, high) != (0.0, 100.0)
        note = f"{low:g} to {high:g} % of the values" if is_stated else self.note
        return f"{text}\n{note}" if note else text


OF_VALUES = ColourScale()


def make_image_figure(bounds: Bounds, title: str, unit: LengthUnit = PIXELS, *,
                      beside: float = RIGHT_INCHES) -> tuple[Figure, Axes]:
    """Make a figure whose axes are those of the image: equal scales, y down.

    ``bounds`` are x0, y0, x1, y1, in the unit; ``beside`` is the room to the right of the axes, inches, that of a
    colour bar by default. The title is broken into lines where it is wider than the page, which is just as large as
    what is on it.
    """
    figure, (axes,) = make_panels([bounds], [title], unit, beside=beside)
    return figure, axes


def make_panels(boxes: Sequence[Bounds], titles: Sequence[str], unit: LengthUnit = PIXELS, *,
                beside: float = RIGHT_INCHES, panel_inches: float = PANEL_INCHES) -> tuple[Figure, list[Axes]]:
    """Make a figure of several panels of one size, each as ``make_image_figure`` makes its one.

    The first of ``boxes``, in the unit, tells the size of all. Panels stand side by side, each at most
    ``panel_inches`` wide, or above one another where they are wide.
    """
    x0, y0, x1, y1 = boxes[0]
    ratio = (y1 - y0) / max(x1 - x0, 1e-300)
    n_columns = 1 if ratio < WIDE else min(len(boxes), MOST_COLUMNS)
    n_rows = math.ceil(len(boxes) / n_columns)
    widest = (WIDTH_INCHES if n_columns == 1 else panel_inches) - LEFT_INCHES - beside
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
        set_up_axes(axes, box, unit, (width, height))
        # In the middle of the panel, not of the axes, which have more on their right than on their left.
        axes.set_title(title, fontsize=TITLE_POINTS, x=(0.5 * panel_width - left) / width)
        panels.append(axes)
    return figure, panels


def set_up_axes(axes: Axes, bounds: Bounds, unit: LengthUnit, size: Sequence[float]) -> None:
    """Set limits, labels and as many numbers as there is room for; ``size``: width and height of the axes, inches."""
    set_bounds(axes, bounds)
    axes.set_aspect("equal")
    axes.set(xlabel=f"x [{unit.name}]", ylabel=f"y [{unit.name}]")
    for axis, length in zip((axes.xaxis, axes.yaxis), size, strict=True):
        n_numbers = max(2, min(7, int(length / INCHES_A_NUMBER)))
        axis.set_major_locator(MaxNLocator(nbins=n_numbers, steps=[1, 2, 5, 10]))


def list_image_axes(figure: Figure) -> list[Axes]:
    """List the axes of a figure that show an image or a slice, not curves or bars."""
    return [axes for axes in figure.axes if axes.yaxis_inverted() and axes.axison]


def set_bounds(axes: Axes, bounds: Bounds) -> None:
    """Set what axes show, y down: once more after an image was drawn, which moves their limits to its own."""
    x0, y0, x1, y1 = bounds
    axes.set_xlim(x0, x1)
    axes.set_ylim(y1, y0)


def find_mesh_bounds(nodes: Array, margin: float = 0.03) -> Bounds:
    """Find the box x0, y0, x1, y1 around nodes (n, 2), pixels, with a margin relative to its longer side."""
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    gap = margin * float((high - low).max())
    x0, y0 = low - gap
    x1, y1 = high + gap
    return float(x0), float(y0), float(x1), float(y1)


LARGEST_SIDE = 2000
"""Pixels of an image that a figure shows along each axis at most."""

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
        """Draw in grey; below an ``opacity`` of 1 over everything that is there."""
        self.show(axes, size, cmap="gray", zorder=0 if opacity == 1.0 else OVER_ALL, alpha=opacity)

    def show(self, axes: Axes, size: float, **style: Any) -> AxesImage:
        """Show the pixels, ``size`` in the axes' unit, their centres at integers, in a style of ``imshow``."""
        n_rows, n_columns = self.pixels.shape
        left = top = -0.5 * self.step * size
        right, bottom = (n_columns - 0.5) * self.step * size, (n_rows - 0.5) * self.step * size
        return axes.imshow(self.pixels, interpolation="nearest", rasterized=True, extent=(left, right, bottom, top),
                           **style)

    def measure_grey(self) -> float:
        """Measure the mean grey as it is shown, from 0, black, to 1."""
        darkest, brightest = float(self.pixels.min()), float(self.pixels.max())
        return (float(self.pixels.mean()) - darkest) / ((brightest - darkest) or 1.0)

    def clip(self, bounds: Bounds, size: float = 1.0) -> Bounds:
        """Find the part of a box that lies in the image, whose pixels reach half a pixel beyond their centres.

        The box is x0, y0, x1, y1 in the axes' unit, ``size`` a pixel's in that unit.
        """
        x0, y0, x1, y1 = bounds
        return (max(x0, -0.5 * size), max(y0, -0.5 * size), min(x1, (self.width - 0.5) * size),
                min(y1, (self.height - 0.5) * size))


def add_colour_bar(figure: Figure, axes: Axes, mappable: Any, label: str, shown_as: Colormap | None = None) -> None:
    """Add a labelled colour bar as high as the axes, or higher where they are flat.

    ``shown_as`` are its colours where those of ``mappable`` are seen through something else.
    """
    width, height = axes.get_position().size * figure.get_size_inches()
    share = max(1.0, SHORTEST_BAR_INCHES / height)
    # x, y, width, height, of the axes'.
    beside = axes.inset_axes((1.0 + GAP_INCHES / width, 0.5 - 0.5 * share, BAR_INCHES / width, share))
    coloured = mappable if shown_as is None else ScalarMappable(mappable.norm, shown_as)
    bar = figure.colorbar(coloured, cax=beside, label=label, extend=_find_values_beyond(mappable))
    write_powers_of_ten(bar.ax.yaxis)
    bar.ax.yaxis.set_offset_position("left")


def write_powers_of_ten(axis: Axis) -> None:
    """Write small and large numbers times a power of ten: the zeros of strains would need the room of the label."""
    numbers = ScalarFormatter(useMathText=True)
    numbers.set_powerlimits((-2, 4))
    axis.set_major_formatter(numbers)


def _find_values_beyond(mappable: Any) -> Literal["neither", "min", "max", "both"]:
    """Sides of the colours on which there are values beyond, as matplotlib calls them: the bar has arrows there."""
    # Masked where an image has no value; comparisons with nan are false.
    values: Array = np.ma.getdata(mappable.get_array())  # type: ignore[no-untyped-call]
    low, high = mappable.get_clim()
    below, above = bool((values < low).any()), bool((values > high).any())
    return "both" if below and above else "min" if below else "max" if above else "neither"


def make_cell_polygons(mesh: Mesh, nodes: Array, **style: Any) -> PolyCollection:
    """Make polygons of the cells, their nodes drawn at (n_nodes, 2), in a style as matplotlib's collections take it."""
    nodes_of_cells = np.split(mesh.connectivity, mesh.offsets[1:-1])
    corners = [nodes[of_cell] for of_cell in nodes_of_cells]
    return PolyCollection(corners, **style)


def draw_cell_colours(axes: Axes, mesh: Mesh, nodes: Array, values: Array, scale: ColourScale,
                      palette: str = COLOURS) -> PolyCollection:
    """Draw values on cells (n_cells,) in colour, in a palette where the scale has none; nodes are at (n_nodes, 2)."""
    cells = make_cell_polygons(mesh, nodes, array=values, cmap=scale.palette or palette, edgecolors="face",
                               linewidths=0.1, clim=scale.find_limits(values),
                               rasterized=mesh.n_cells > MOST_SHARP_CELLS)
    axes.add_collection(cells)
    return cells


def draw_nodal_colours(axes: Axes, mesh: Mesh, nodes: Array, values: Array, scale: ColourScale) -> TriMesh:
    """Draw values at nodes in colour, interpolated; nothing where a cell has a node without one, which is nan."""
    shown = np.zeros(mesh.n_cells, dtype=bool)
    shown[mesh.find_cells_among(np.isfinite(values))] = True
    of_cells = [block.cells for block in mesh.cell_blocks for _ in block.type.triangles]
    triangulation = make_triangulation(mesh, nodes)
    triangulation.set_mask(~shown[np.concatenate(of_cells)])
    low, high = scale.find_limits(values)
    colours: TriMesh = axes.tripcolor(triangulation, values, shading="gouraud", cmap=scale.palette or COLOURS, vmin=low,
                                      vmax=high, rasterized=True)
    return colours


def make_triangulation(mesh: Mesh, nodes: Array) -> Triangulation:
    """Cut the cells into triangles on all nodes, which are drawn at (n_nodes, 2)."""
    triangles = [block.nodes[:, corners] for block in mesh.cell_blocks for corners in block.type.triangles]
    return Triangulation(nodes[:, 0], nodes[:, 1], np.concatenate(triangles))


def pick_component(vectors: Array, component: Component) -> Array:
    """Pick one component of vectors (n, dim), or their length, (n,)."""
    if component == "magnitude":
        return np.asarray(np.hypot.reduce(vectors, axis=1))
    return vectors[:, schema.AXES.index(component)]


def format_component(symbol: str, component: Component) -> str:
    """Write a component of a vector as a label does, in TeX."""
    return f"$|{symbol}|$" if component == "magnitude" else f"${symbol}_{component}$"


def format_component_label(symbol: str, component: Component, unit: LengthUnit) -> str:
    """Label a colour bar with a component of a vector and its unit."""
    return f"{format_component(symbol, component)} [{unit.name}]"


def save_figure(figure: Figure, path: Path, dpi: int = DPI, files: NewFiles | None = None) -> None:
    """Save a figure in the format that the ending of the path tells: png, pdf, svg.

    In PDF and SVG ``dpi`` is of images and of fields in colour, beside which texts and lines stay sharp. The file takes
    its name with ``files``; by default it does so by itself. Raises InputError or OSError where it cannot be written;
    an earlier one stays.
    """
    ending = path.suffix.lower()
    # Journals refuse type 3, matplotlib's own choice; without a date the same picture is the same file.
    with rc_context({"pdf.fonttype": 42, "svg.hashsalt": path.stem}):
        dated = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
        with begin_files(files) as new:
            figure.savefig(new.begin(path), format=ending.removeprefix("."), dpi=dpi, metadata=dated.get(ending))


CAPTION_POINTS = 11.0
"""Size of the caption's type."""

ROOM_INCHES = 0.34
"""Height of the caption with what is around it."""


def format_caption(number: int, time: float) -> str:
    """Write in a short line which frame it is, from 1, and its time."""
    return f"frame {number}, time {time:g}"


def draw_caption(figure: Figure, text: str) -> None:
    """Write a text, short enough for one line, above all that is on a page, which grows by it."""
    height = make_room_above(figure, ROOM_INCHES)
    figure.text(0.5, 1.0 - 0.5 * ROOM_INCHES / height, text, ha="center", va="center", fontsize=CAPTION_POINTS,
                fontweight="bold")


def set_titles(figure: Figure, text: str) -> None:
    """Put a text in the place of the titles of a page's axes; the page shrinks where it is empty."""
    titled = [axes for axes in figure.axes if axes.get_title()]
    if not titled:
        return
    n_lines = max(axes.get_title().count("\n") + 1 for axes in titled)
    for axes in titled:
        axes.set_title("")
    width = float(figure.get_size_inches()[0])
    lines = format_title(text, width - 2 * GAP_INCHES, TITLE_POINTS)
    n_more = lines.count("\n") + 1 - n_lines if lines else -n_lines
    height = make_room_above(figure, LINE_INCHES * n_more)
    if lines:
        figure.text(0.5, 1.0 - 0.5 * ABOVE_INCHES / height, lines, ha="center", va="top", fontsize=TITLE_POINTS)


BAR_SHARE = 0.2
"""Length of a scale bar over the width of the axes, at most, where none is asked for."""


def draw_scale_bar(axes: Axes, unit: LengthUnit, length: float | None = None) -> None:
    """Draw a bar with its length, of the axes' unit; a round one of at most a fifth of the axes' width by default."""
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    width, height = right - left, high - low
    if length is None:
        power = 10.0 ** math.floor(math.log10(BAR_SHARE * width))
        length = power * max(step for step in (1, 2, 5) if step * power <= BAR_SHARE * width)
    begin, y = left + 0.05 * width, low + 0.06 * height
    outline = [withStroke(linewidth=4.0, foreground="black")]
    axes.plot([begin, begin + length], [y, y], color="white", linewidth=2.5, solid_capstyle="butt",
              path_effects=outline, clip_on=False)
    axes.annotate(f"{length:g} {unit.name}", (begin + 0.5 * length, y), xytext=(0, 4), textcoords="offset points",
                  ha="center", va="bottom", color="white", fontsize=10, fontweight="bold",
                  path_effects=[withStroke(linewidth=2.5, foreground="black")])


WORDS = "not converged"

FAILURE_COLOUR = "#b00020"
"""Dark red, which has a contrast of 7 to 1 with white: it is read in print without colours too."""

MARK_POINTS = 12.0
"""Size of the mark's type; a larger value takes more of the page."""

MARK_INCHES = 0.24
"""Height of a line of the mark."""

EDGE_INCHES = 0.1
"""Between the mark and the edges of the page."""


def draw_failures(figure: Figure, shown: Sequence[Result]) -> None:
    """Write above all that is on a page that a result did not converge; nothing where all did.

    The page grows by what that takes; what was on it keeps its size. Failures of several results are told by the names
    of their files.
    """
    failed = [result for result in shown if not result.converged]
    if not failed:
        return
    text = WORDS if len(shown) == 1 else f"{', '.join(result.path.name for result in failed)}: {WORDS}"
    lines = format_title(text, figure.get_size_inches()[0] - 2 * EDGE_INCHES, MARK_POINTS)
    height = make_room_above(figure, EDGE_INCHES + MARK_INCHES * (lines.count("\n") + 1))
    figure.text(0.5, 1.0 - EDGE_INCHES / height, lines, ha="center", va="top", fontsize=MARK_POINTS,
                fontweight="bold", color=FAILURE_COLOUR, linespacing=MARK_INCHES * POINTS_AN_INCH / MARK_POINTS / 1.2)


PLACE_COLOUR = "#00e5ff"
"""Of marks: seen on the dark and on the bright end of the residual's colours."""


def draw_marks(axes: Axes, places: Mapping[int, Sequence[float]], size: float = 1.0) -> None:
    """Draw a circle about each place, pixels, with its number; ``size`` is a pixel's in the axes' unit."""
    outline = [withStroke(linewidth=3.0, foreground="black")]
    right = axes.get_xlim()[1]
    for number, (x, y) in places.items():
        at = (size * x, size * y)
        axes.plot(*at, "o", markersize=13, markerfacecolor="none", markeredgecolor=PLACE_COLOUR, markeredgewidth=1.8,
                  path_effects=outline, clip_on=False)
        # On the left of places near the right edge, so that no number leaves the picture.
        is_right = at[0] > 0.9 * right
        axes.annotate(str(number), at, xytext=(-11 if is_right else 11, 0), textcoords="offset points",
                      color=PLACE_COLOUR, fontsize=11, fontweight="bold", va="center",
                      ha="right" if is_right else "left", path_effects=outline)
