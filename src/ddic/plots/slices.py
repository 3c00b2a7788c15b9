"""Slices across a volume, on which fields are sampled, over the grey levels there; three are orthogonal views.

Cells are not cut: a slice is a regular grid of points in a plane, each looked up once in the mesh.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import NDArray

from ddic.arrays import Array, BoolArray, IntArray
from ddic.errors import InputError
from ddic.images.source import ImageSource
from ddic.images.window import Window
from ddic.io.result_schema import AXES
from ddic.mesh.interpolation import CellSearch, Located, interpolate_located
from ddic.mesh.mesh import Mesh
from ddic.plots import canvas
from ddic.plots.canvas import PIXELS, Bounds, LengthUnit, Preview

PLANES = {"z": "xy", "x": "zy", "y": "xz"}
"""Axes across and down a slice by the one that it stands on, in the order in which they are drawn: the second beside
the first shares its y, the third below it its x."""

N_SAMPLES = 500
"""Points along the longest side of the mesh; a larger value shows cells sharper, and takes longer."""

LARGEST_SIDE = 1000
"""Voxels that are shown along each side of a slice at most."""

MARGIN = 0.06
"""Of the volume that is shown around the mesh, relative to its longest side."""

GAP = 0.07
"""Between orthogonal views and above them, where their places are named, relative to all of them together."""

NAME_POINTS = 9.0
"""Type of these names."""

VIEWS_INCHES = 5.4
"""Width of one of several pages of orthogonal views side by side."""


@dataclass(frozen=True, eq=False)
class Slice:
    """A plane across a volume, seen along the axis that it stands on.

    Attributes
    ----------
    axis : {"x", "y", "z"}
        That axis.
    place : float
        Where on it, voxels.
    box, shown : (float, float, float, float)
        Of the mesh, which the points fill, and what is shown around it: x0, y0, x1, y1 in the plane, voxels.
    shape : (int, int)
        Rows and columns of points.
    search : CellSearch
        Of the mesh.
    grey : Preview or None
        Grey levels in the plane.
    """

    axis: str
    place: float
    box: Bounds
    shown: Bounds
    shape: tuple[int, int]
    search: CellSearch
    grey: Preview | None = None

    def describe(self, unit: LengthUnit) -> str:
        """Say which plane it is."""
        return f"{self.axis} = {unit.size * self.place:g} {unit.name}"

    @property
    def columns(self) -> list[int]:
        """Numbers of the axes across and down."""
        return [AXES.index(name) for name in PLANES[self.axis]]

    def measure_distance(self, position: Array) -> float:
        """Measure how far a position, (3,), lies from the plane, voxels."""
        return abs(float(position[AXES.index(self.axis)]) - self.place)

    @cached_property
    def _located(self) -> Located:
        """The points, row by row, in the mesh."""
        points = np.full((*self.shape, 3), self.place)
        points[..., self.columns] = self.points
        return self.search.locate(points.reshape(-1, 3))

    @property
    def cells(self) -> IntArray:
        """The cell at each point, (rows, columns), -1 where there is none."""
        return self._located.cells.reshape(self.shape)

    @property
    def points(self) -> Array:
        """The points in the plane, (rows, columns, 2), voxels: the middles of the rectangles that make up the box."""
        x0, y0, x1, y1 = self.box
        rows, columns = ((np.arange(n) + 0.5) / n for n in self.shape)
        return np.stack(np.meshgrid(x0 + columns * (x1 - x0), y0 + rows * (y1 - y0)), axis=-1)

    @property
    def edges(self) -> BoolArray:
        """Points, (rows, columns), before which another cell lies."""
        cells, edges = self.cells, np.zeros(self.shape, dtype=bool)
        edges[1:] = cells[1:] != cells[:-1]
        edges[:, 1:] |= cells[:, 1:] != cells[:, :-1]
        return edges

    def sample(self, values: Array, *, by_cell: bool = False) -> Array:
        """Sample values at nodes or on cells, (n,), at the points, (rows, columns); nan where there is no cell."""
        if by_cell:
            return np.append(values, np.nan)[self.cells]
        return interpolate_located(self.search.mesh, values[:, None], self._located).reshape(self.shape)

    def show(self, axes: Axes, sampled: NDArray[Any], unit: LengthUnit, **style: Any) -> AxesImage:
        """Show what was sampled, values or colours, in a style of ``imshow``, over the grey levels."""
        x0, y0, x1, y1 = _convert(self.box, unit)
        drawn = axes.imshow(sampled, rasterized=True, extent=(x0, x1, y1, y0), zorder=1, **style)
        if self.grey is not None:
            self.grey.draw(axes, unit.size)
        self.set_bounds(axes, unit)
        return drawn

    def set_bounds(self, axes: Axes, unit: LengthUnit) -> None:
        """Set what axes show: once more after an image was drawn."""
        canvas.set_bounds(axes, _convert(self.shown, unit))

    def read(self, read: Callable[[Window], NDArray[Any]], extent: Window) -> Preview:
        """Read the plane of a volume's voxels that is nearest, thinned out; ``read`` gives windows of it."""
        axis = AXES.index(self.axis)
        lower, upper = list(extent.lower), list(extent.upper)
        lower[axis] = int(np.clip(np.rint(self.place), lower[axis], upper[axis] - 1))
        upper[axis] = lower[axis] + 1
        # Arrays have z first: across the x axis they have columns of z.
        pixels = read(Window(tuple(lower), tuple(upper))).squeeze(2 - axis)
        pixels = pixels.T if self.axis == "x" else pixels
        height, width = pixels.shape
        step = -(-max(height, width) // LARGEST_SIDE)
        return Preview(pixels[::step, ::step], step, width, height)


Slices = tuple[Slice, ...]

Below = Preview | Slices | None
"""What values are drawn over: an image, or nothing; of a volume slices, with its grey levels where they are known."""


def list_grey_levels(below: Below) -> NDArray[Any]:
    """List the grey levels that are shown, (n,), of an image or of all slices of a volume."""
    previews = [one.grey for one in below] if isinstance(below, tuple) else [below]
    return np.concatenate([preview.pixels.ravel() for preview in previews if preview is not None])


def _convert(bounds: Bounds, unit: LengthUnit) -> Bounds:
    """Bounds, voxels, in a unit."""
    x0, y0, x1, y1 = bounds
    return unit.size * x0, unit.size * y0, unit.size * x1, unit.size * y1


def choose_slices(mesh: Mesh, volume: ImageSource | None, asked: Sequence[tuple[str, float]] = ()) -> Slices:
    """Choose the slices that are asked for by axis and place, voxels; by default three through the mesh's middle.

    Raises InputError where one of them misses the mesh.
    """
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    if not asked:
        # Whole voxels in the middle of cells, not between them.
        centres = mesh.centroids
        middle = centres[np.abs(centres - 0.5 * (low + high)).argmin(axis=0), range(3)]
        asked = [(axis, float(np.rint(middle[AXES.index(axis)]))) for axis in PLANES]
    search = CellSearch(mesh)
    return tuple(_make_slice(search, volume, axis, place, (low, high)) for axis, place in asked)


def _make_slice(search: CellSearch, volume: ImageSource | None, axis: str, place: float,
                corners: tuple[Array, Array]) -> Slice:
    """The slice at a place between the corners of the mesh."""
    low, high = corners
    number, columns = AXES.index(axis), [AXES.index(name) for name in PLANES[axis]]
    if not low[number] <= place <= high[number]:
        raise InputError(f"--slice {axis}={place:g}: the mesh lies between {axis} = {low[number]:g} and "
                         f"{high[number]:g} voxels")
    longest = float((high - low).max())
    n_columns, n_rows = np.maximum(1, np.rint(N_SAMPLES * (high - low)[columns] / longest)).astype(int).tolist()
    x0, y0, x1, y1 = box = (*low[columns].tolist(), *high[columns].tolist())
    gap = MARGIN * longest
    shown = (x0 - gap, y0 - gap, x1 + gap, y1 + gap)
    made = Slice(axis, place, box, shown, (n_rows, n_columns), search)
    if volume is None:
        return made
    grey = made.read(volume.read, volume.extent)
    return replace(made, grey=grey, shown=grey.clip(shown))


@dataclass(frozen=True, eq=False)
class Views:
    """The slices below one title.

    Attributes
    ----------
    axes : list of Axes
        Of each slice.
    hosts : list of Axes
        Beside which colour bars stand.
    """

    axes: list[Axes]
    hosts: list[Axes]


def make_views(slices: Slices, titles: Sequence[str], unit: LengthUnit = PIXELS, *,
               beside: float = canvas.RIGHT_INCHES) -> tuple[Figure, list[Views]]:
    """Make a figure with the slices below each title: one of each axis as orthogonal views, others as panels.

    Thin lines show where they cut one another. ``beside`` is the room to the right of the axes, inches.
    """
    is_orthogonal = sorted(one.axis for one in slices) == sorted(PLANES)
    if is_orthogonal:
        figure, views = _make_orthogonal(slices, titles, unit, beside)
    else:
        boxes = [_convert(one.shown, unit) for one in slices]
        named = [f"{title}, {one.describe(unit)}" for title in titles for one in slices]
        figure, panels = canvas.make_panels(boxes * len(titles), named, unit, beside=beside)
        by_title = [panels[k:k + len(slices)] for k in range(0, len(panels), len(slices))]
        views = [Views(axes, axes) for axes in by_title]
    for of_title in views:
        for axes, one in zip(of_title.axes, slices, strict=True):
            across, down = (f"{name} [{unit.name}]" for name in PLANES[one.axis])
            # Numbers and name of an axis that two views share stand at the outer one.
            axes.set(xlabel="" if is_orthogonal and one.axis == "z" else across,
                     ylabel="" if is_orthogonal and one.axis == "x" else down)
            axes.tick_params(labelbottom=bool(axes.get_xlabel()), labelleft=bool(axes.get_ylabel()))
            _mark_places(axes, one, slices, unit)
    return figure, views


def _mark_places(axes: Axes, one: Slice, others: Slices, unit: LengthUnit) -> None:
    """Lines on a slice where others cut it."""
    for other in others:
        if other.axis == one.axis:
            continue
        draw = axes.axvline if other.axis == PLANES[one.axis][0] else axes.axhline
        # White dashes on black are seen on all colours.
        for colour, style in (("black", "-"), ("white", (0, (3, 3)))):
            draw(unit.size * other.place, color=colour, linestyle=style, linewidth=0.6, zorder=canvas.OVER_ALL)


def _make_orthogonal(slices: Slices, titles: Sequence[str], unit: LengthUnit,
                     beside: float) -> tuple[Figure, list[Views]]:
    """Views of one scale that share axes: across x beside that across z, across y below it."""
    boxes = {one.axis: _convert(one.shown, unit) for one in slices}
    sides = {axis: np.subtract(box[2:], box[:2]) for axis, box in boxes.items()}
    (width, height), depth = sides["z"], sides["x"][0]
    gap = GAP * max(width + depth, height + depth)
    whole = np.array([width + gap + depth, height + depth + 2.0 * gap])
    corners = {"z": (0.0, gap), "x": (width + gap, gap), "y": (0.0, height + 2.0 * gap)}
    figure, hosts = canvas.make_panels([(0.0, 0.0, *whole.tolist())] * len(titles), titles, unit, beside=beside,
                                       panel_inches=VIEWS_INCHES)
    views = []
    for host in hosts:
        host.set_axis_off()
        host.set(xlabel="", ylabel="", xticks=[], yticks=[])
        place = host.get_position()
        drawn = []
        for one in slices:
            share, corner = sides[one.axis] / whole, np.array(corners[one.axis]) / whole
            below = 1.0 - corner[1] - share[1]
            axes = figure.add_axes((*(place.p0 + place.size * np.array([corner[0], below])), *(place.size * share)))
            canvas.set_up_axes(axes, boxes[one.axis], unit, place.size * share * figure.get_size_inches())
            # Beside the edge of the page there may be no room for it.
            axes.set_title(one.describe(unit), loc="right" if one.axis == "x" else "left", fontsize=NAME_POINTS,
                           pad=3.0)
            drawn.append(axes)
        views.append(Views(drawn, [host]))
    return figure, views
