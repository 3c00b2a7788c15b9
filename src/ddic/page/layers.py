"""What is laid over an image: a mesh, a field in colour, hatching of cells that say nothing."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray

from ddic.arrays import Array, BoolArray, IntArray
from ddic.mesh.interpolation import Located, interpolate_located, locate
from ddic.mesh.mesh import Mesh
from ddic.page.image_pane import Rgba, ScreenRaster

Colour = tuple[int, int, int]

OPACITY = 0.7
"""Of colours over the image, as in the figures of ``ddic plot``."""

SMALLEST_CELL = 5.0
"""Side of a cell on the screen, pixels, below which its edges are left out: they would hide the image."""

HATCH, STROKE = 9, 3
"""From one stroke of the hatching to the next, and its width, pixels of the screen."""

SUBPIXEL_BITS = 4
"""Of the places of lines: sixteenths of a pixel."""


def draw_edges(rgba: Rgba, raster: ScreenRaster, mesh: Mesh, outline: IntArray, colour: Colour) -> None:
    """Draw the edges of the cells in sight; where cells are too small on the screen, the outline of the mesh alone.

    ``outline`` are both nodes of its edges, (n_edges, 2).
    """
    corners = raster.place(mesh.nodes)
    low, high = mesh.outlines.find_boxes()
    x0, y0, x1, y1 = raster.box
    in_sight = np.flatnonzero(((high >= (x0, y0)) & (low <= (x1, y1))).all(axis=1))
    sides = float(np.median(high - low)) / raster.pitch[0]
    if sides >= SMALLEST_CELL:
        _draw_lines(rgba, [corners[mesh.get_cell(cell)] for cell in in_sight], colour, closed=True)
    else:
        _draw_lines(rgba, list(corners[outline]), colour, closed=False)


def _draw_lines(rgba: Rgba, lines: list[Array], colour: Colour, *, closed: bool) -> None:
    places = [np.round(line * 2**SUBPIXEL_BITS).astype(np.int32) for line in lines]
    cv2.polylines(rgba, places, closed, (*colour, 255), 1, cv2.LINE_AA, SUBPIXEL_BITS)


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
    def find(cls, mesh: Mesh, raster: ScreenRaster) -> Overlay:
        """Find the cell of each pixel."""
        return cls(mesh, locate(mesh, raster.centres))

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
    known = np.isfinite(values).reshape(rgba.shape[:2])
    share = np.clip((values[known.ravel()] - low) / (high - low), 0.0, 1.0)
    colours = list_colours(palette)[np.round(255.0 * share).astype(int)]
    rgba[known, :3] = np.round(OPACITY * colours + (1.0 - OPACITY) * rgba[known, :3])


def list_colours(palette: str) -> NDArray[np.uint8]:
    """List the colours of one of matplotlib's colour maps, (256, 3)."""
    return np.asarray(colormaps[palette](np.arange(256) / 255.0, bytes=True)[:, :3])


def draw_hatching(rgba: Rgba, is_hatched: BoolArray, colour: Colour) -> None:
    """Draw strokes over pixels, (n,)."""
    rows, columns = np.indices(rgba.shape[:2])
    strokes = is_hatched.reshape(rgba.shape[:2]) & ((rows + columns) % HATCH < STROKE)
    rgba[strokes, :3] = colour
