"""What is laid over an image: a mesh, a field in colour, hatching of cells that say nothing."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray

from ddic.arrays import Array, BoolArray, IntArray
from ddic.mesh.grid import GridLines
from ddic.mesh.interpolation import CellSearch, Located, interpolate_located
from ddic.mesh.mesh import Mesh
from ddic.page.image_pane import Rgba, ScreenRaster

Colour = tuple[int, int, int]

OPACITY = 0.7
"""Of colours over the image, as in the figures of ``ddic plot``."""

SMALLEST_CELL = 5.0
"""Side of a cell on the screen, pixels, below which its edges are left out: they would hide the image."""

HATCH, STROKE = 9, 3
"""From one stroke of the hatching to the next, and its width, pixels of the screen."""

DOT = 4
"""Side of a dot, pixels of the screen."""

SUBPIXEL_BITS = 4
"""Of the places of lines: sixteenths of a pixel."""


def draw_edges(rgba: Rgba, raster: ScreenRaster, mesh: Mesh | GridLines, outline: IntArray, colour: Colour) -> None:
    """Draw the edges of the cells in sight; where cells are too small on the screen, the outline of the mesh alone.

    ``outline`` are both nodes of the edges at the boundary of a mesh, (n_edges, 2).
    """
    if isinstance(mesh, GridLines):
        _draw_lines(rgba, raster, _list_lines(mesh, raster), colour, closed=False)
        return
    low, high = mesh.outlines.find_boxes()
    if float(np.median(high - low)) / raster.pitch[0] < SMALLEST_CELL:
        _draw_lines(rgba, raster, mesh.nodes[outline], colour, closed=False)
        return
    x0, y0, x1, y1 = raster.box
    in_sight = ((high >= (x0, y0)) & (low <= (x1, y1))).all(axis=1)
    for block in mesh.cell_blocks:
        _draw_lines(rgba, raster, mesh.nodes[block.nodes[in_sight[block.cells]]], colour, closed=True)


def _list_lines(grid: GridLines, raster: ScreenRaster) -> Array:
    """Both ends of the lines of a grid that may be in sight, (n, 2, 2), pixels."""
    if grid.cell_size / raster.pitch[0] < SMALLEST_CELL:
        grid = GridLines(tuple(line[[0, -1]] for line in grid.lines))
    x0, y0, x1, y1 = grid.box
    x, y = _list_lines_in_sight(grid, raster)
    upright, level = [[(at, y0), (at, y1)] for at in x], [[(x0, at), (x1, at)] for at in y]
    return np.array([*upright, *level]).reshape(-1, 2, 2)


def _draw_lines(rgba: Rgba, raster: ScreenRaster, lines: Array, colour: Colour, *, closed: bool) -> None:
    """Draw lines through points, (n, n_points, 2), pixels of the image."""
    places = np.round(raster.place(lines) * 2**SUBPIXEL_BITS).astype(np.int32)
    cv2.polylines(rgba, list(places), closed, (*colour, 255), 1, cv2.LINE_AA, SUBPIXEL_BITS)


def draw_dots(rgba: Rgba, raster: ScreenRaster, points: Array, colour: Colour) -> None:
    """Draw dots at points, (n, 2), pixels of the image."""
    height, width = rgba.shape[:2]
    columns, rows = np.round(raster.place(points)).astype(int).T
    seen = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    dots = np.zeros((height, width), np.uint8)
    dots[rows[seen], columns[seen]] = 1
    rgba[cv2.dilate(dots, np.ones((DOT, DOT), np.uint8)) > 0, :3] = colour


def find_nodes_in_sight(mesh: Mesh | GridLines, raster: ScreenRaster) -> Array:
    """Find nodes that may be in sight, (n, 2), pixels; of a grid finer than dots on the screen, some in each dot."""
    if isinstance(mesh, Mesh):
        return mesh.nodes
    step = max(int(DOT * raster.pitch[0] / mesh.cell_size), 1)
    return GridLines(tuple(line[::step] for line in _list_lines_in_sight(mesh, raster))).nodes


def _list_lines_in_sight(grid: GridLines, raster: ScreenRaster) -> list[Array]:
    """Places of the lines of a grid along each axis that may be in sight, pixels."""
    sides = zip(grid.lines, raster.box[:2], raster.box[2:], strict=True)
    return [line[(line >= low) & (line <= high)] for line, low, high in sides]


def find_cell_centres(mesh: Mesh | GridLines, raster: ScreenRaster) -> Array:
    """Find the centre of the cell that holds each pixel of a raster, (n, 2), pixels; nan in it where none does."""
    if isinstance(mesh, Mesh):
        overlay = Overlay.find(CellSearch(mesh), raster)
        return np.column_stack([overlay.interpolate(centres, by_cell=True) for centres in mesh.centroids.T])
    found = []
    for lines, places in zip(mesh.lines, raster.centres.T, strict=True):
        # Before the first line and behind the last one it is the last of these.
        centres = np.append(0.5 * (lines[1:] + lines[:-1]), np.nan)
        found.append(centres[np.searchsorted(lines, places, side="right") - 1])
    return np.column_stack(found)


@dataclass(frozen=True, eq=False)
class Overlay:
    """Where the pixels of a raster lie in a mesh, so that many fields and frames are drawn by one search.

    Attributes
    ----------
    mesh : Mesh
        As it lies in the image.
    located : Located
        Of the pixels, row by row.
    """

    mesh: Mesh
    located: Located

    @classmethod
    def find(cls, search: CellSearch, raster: ScreenRaster) -> Overlay:
        """Find the cell of each pixel."""
        return cls(search.mesh, search.locate(raster.centres))

    def interpolate(self, values: Array, *, by_cell: bool) -> Array:
        """Interpolate values at nodes, or take those on cells, at the pixels, (n,); nan outside the mesh."""
        if not by_cell:
            return interpolate_located(self.mesh, values[:, None], self.located)[:, 0]
        cells = self.located.cells
        return np.where(cells >= 0, values[np.maximum(cells, 0)], np.nan)

    def find_pixels(self, is_marked: BoolArray) -> BoolArray:
        """Find the pixels of marked cells, (n,)."""
        cells = self.located.cells
        return np.asarray((cells >= 0) & is_marked[np.maximum(cells, 0)])


def draw_field(rgba: Rgba, values: Array, limits: tuple[float, float], palette: str) -> None:
    """Draw values of the pixels, (n,), over the image; where they are nan the image stays."""
    low, high = limits
    places = values.reshape(rgba.shape[:2])
    share = np.clip((places - low) / (high - low), 0.0, 1.0)
    colours = np.take(list_colours(palette), np.round(255.0 * np.nan_to_num(share)).astype(np.uint8), axis=0)
    blended = cv2.addWeighted(colours, OPACITY, rgba[..., :3], 1.0 - OPACITY, 0.0)
    np.copyto(rgba[..., :3], blended, where=np.isfinite(places)[..., None])


def list_colours(palette: str) -> NDArray[np.uint8]:
    """List the colours of one of matplotlib's colour maps, (256, 3)."""
    return np.asarray(colormaps[palette](np.arange(256) / 255.0, bytes=True)[:, :3])


def draw_hatching(rgba: Rgba, is_hatched: BoolArray, colour: Colour) -> None:
    """Draw strokes over pixels, (n,)."""
    rows, columns = np.indices(rgba.shape[:2])
    strokes = is_hatched.reshape(rgba.shape[:2]) & ((rows + columns) % HATCH < STROKE)
    rgba[strokes, :3] = colour
