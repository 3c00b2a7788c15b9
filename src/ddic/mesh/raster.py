"""Rasterisation: every pixel centre belongs to exactly one cell.

A pixel centre (x, y) belongs to the cell whose row y holds x_left <= x < x_right, where the ends are
the crossings of the row with the cell's edges. An edge from a to b crosses the rows y_a <= y < y_b.
Both neighbours of an edge compute its crossings from the same two nodes in the same order, hence get
the same floating-point number, hence share no pixel and leave none.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, BoolArray, IntArray
from ddic.images.window import Window
from ddic.mesh.cell_parts import find_offsets, list_ranges
from ddic.mesh.mesh import Mesh

SNAP = float(2**20)
"""Crossings are rounded to multiples of 1/SNAP px, so that rounding errors where two edges meet cannot fall on
different sides of a pixel centre; a larger value rounds less and forgives less."""


@dataclass(frozen=True)
class Raster:
    """Runs of pixels of every cell, row by row.

    Attributes
    ----------
    first_row : (n_cells,) int64 array
        Image row of each cell's first run.
    row_ptr : (n_cells + 1,) int64 array
        Cell e owns runs row_ptr[e]:row_ptr[e + 1], one per row.
    starts, stops : (n_runs,) int32 arrays
        Half-open columns of each run (may be empty).
    """

    first_row: IntArray
    row_ptr: IntArray
    starts: NDArray[np.int32]
    stops: NDArray[np.int32]

    @cached_property
    def pixel_counts(self) -> IntArray:
        """Number of pixels of each cell, (n_cells,)."""
        up_to = find_offsets(self.stops - self.starts)
        return np.asarray(up_to[self.row_ptr[1:]] - up_to[self.row_ptr[:-1]])

    @property
    def rows(self) -> IntArray:
        """Image row of each run, (n_runs,)."""
        return list_ranges(self.first_row, np.diff(self.row_ptr))

    @property
    def window(self) -> Window:
        """Bounding box of all pixels; raises ValueError where there is none."""
        filled = self.stops > self.starts
        if not filled.any():
            raise ValueError("no pixel centre lies inside the mesh")
        rows = self.rows[filled]
        return Window.between([self.starts[filled].min(), rows.min()], [self.stops[filled].max(), rows.max() + 1])

    def find_covered(self, width: int, height: int) -> NDArray[np.uint8]:
        """Draw the pixels that belong to a cell: 1 there, 0 elsewhere, (height, width)."""
        return self.draw_cells(np.arange(len(self.first_row)), Window.of_size(width, height))

    def draw_cells(self, cells: IntArray, window: Window) -> NDArray[np.uint8]:
        """Draw the pixels of some cells in a window: 1 there, 0 elsewhere."""
        runs, rows, _ = self.find_runs(cells)
        inside = (rows >= window.y0) & (rows < window.y1)
        starts, stops = (np.clip(ends[runs[inside]] - window.x0, 0, window.width) for ends in (self.starts, self.stops))
        drawn = np.zeros(window.shape, dtype=np.uint8)
        _fill_ones(rows[inside] - window.y0, starts, stops, drawn)
        return drawn

    def find_runs(self, cells: IntArray) -> tuple[IntArray, IntArray, IntArray]:
        """Find the runs of some cells: numbers, image rows and cells of the runs, (n_runs,) each."""
        n_rows = np.diff(self.row_ptr)[cells]
        runs, rows = (list_ranges(first[cells], n_rows) for first in (self.row_ptr, self.first_row))
        return runs, rows, np.repeat(cells, n_rows)

    def sum_by_cell(self, image: NDArray[Any], x0: int = 0, y0: int = 0) -> NDArray[Any]:
        """Add up an image, whose first pixel is at (x0, y0), over each cell's pixels; nothing outside of it counts.

        Sums, (n_cells,), are int64 for an image of integers, else float64.
        """
        is_counted = np.issubdtype(image.dtype, np.integer)
        sums = np.zeros(len(self.first_row), dtype=np.int64 if is_counted else np.float64)
        _add_up_pixels(image, x0, y0, self.first_row, self.row_ptr, self.starts, self.stops, sums)
        return sums


def rasterize(mesh: Mesh) -> Raster:
    """Find the pixels of every cell; cells must be convex, with straight edges."""
    outlines = mesh.outlines
    y = outlines.corners[outlines.connectivity, 1]
    first_row = np.ceil(np.minimum.reduceat(y, outlines.offsets[:-1])).astype(np.int64)
    last_row = np.ceil(np.maximum.reduceat(y, outlines.offsets[:-1])).astype(np.int64)
    row_ptr = find_offsets(np.maximum(last_row - first_row, 0))
    starts, stops = np.empty((2, row_ptr[-1]), dtype=np.int32)
    _fill_runs(*outlines, first_row, row_ptr, starts, stops)
    return Raster(first_row, row_ptr, starts, stops)


def find_crossings(ends: Array) -> tuple[IntArray, IntArray, IntArray]:
    """Find where sides of cells, (n_sides, 2 ends, 2), pixels, cross the rows of an image.

    Gives side, row and column of each crossing; the column is the first pixel behind it, the very one with which
    ``rasterize`` begins or ends a run.
    """
    falls = ends[:, 0, 1] > ends[:, 1, 1]
    low, high = np.where(falls[:, None], ends[:, 1], ends[:, 0]), np.where(falls[:, None], ends[:, 0], ends[:, 1])
    first_row = np.ceil(low[:, 1]).astype(np.int64)
    n_rows = np.ceil(high[:, 1]).astype(np.int64) - first_row
    sides = np.repeat(np.arange(len(ends)), n_rows)
    rows = list_ranges(first_row, n_rows)
    (xa, ya), (xb, yb) = low[sides].T, high[sides].T
    x = xa + (rows - ya) / (yb - ya) * (xb - xa)
    return sides, rows, np.ceil(np.round(x * SNAP) / SNAP).astype(np.int64)


def prepare_kernels() -> None:
    """Call a compiled kernel on nothing: the first of a process takes a tenth of a second, whichever it is."""
    numbers, columns = np.zeros(0, np.int64), np.zeros(0, np.int32)
    begins = np.zeros(1, np.int64)
    _fill_runs(np.zeros((0, 2)), numbers, begins, numbers, begins, columns, columns)


@numba.njit(cache=True)
def _fill_runs(nodes, connectivity, offsets, first_row, row_ptr, starts, stops):  # type: ignore[no-untyped-def]
    """Cut every row of every cell by its edges."""
    for e in range(len(offsets) - 1):
        begin, end = offsets[e], offsets[e + 1]
        n_rows = row_ptr[e + 1] - row_ptr[e]
        for k in range(n_rows):
            y = first_row[e] + k
            left, right = np.inf, -np.inf
            for i in range(begin, end):
                a = connectivity[i]
                b = connectivity[i + 1] if i + 1 < end else connectivity[begin]
                if nodes[a, 1] > nodes[b, 1]:
                    a, b = b, a
                ya, yb = nodes[a, 1], nodes[b, 1]
                if not (ya <= y < yb):
                    continue
                x = nodes[a, 0] + (y - ya) / (yb - ya) * (nodes[b, 0] - nodes[a, 0])
                x = np.round(x * SNAP) / SNAP
                left = min(left, x)
                right = max(right, x)
            r = row_ptr[e] + k
            if right > left:
                starts[r] = np.int32(np.ceil(left))
                stops[r] = np.int32(np.ceil(right))
            else:
                starts[r] = 0
                stops[r] = 0


@numba.njit(cache=True)
def _add_up_pixels(image, x0, y0, first_row, row_ptr, starts, stops, sums):  # type: ignore[no-untyped-def]
    """Add each cell's pixels of an image to its sum."""
    height, width = image.shape
    for e in range(len(first_row)):
        top = first_row[e] - y0 - row_ptr[e]
        total = sums[e]
        for r in range(row_ptr[e], row_ptr[e + 1]):
            if 0 <= top + r < height:
                for x in range(max(starts[r] - x0, 0), min(stops[r] - x0, width)):
                    total += image[top + r, x]
        sums[e] = total


@numba.njit(cache=True)
def _fill_ones(rows, starts, stops, image):  # type: ignore[no-untyped-def]
    """Put 1 on the pixels of some runs."""
    for k in range(len(rows)):
        image[rows[k], starts[k]:stops[k]] = 1


def list_pixels(raster: Raster, cells: IntArray) -> tuple[IntArray, IntArray]:
    """List the pixels of some cells, columns and rows, (n, 2), and the cell of each, (n,)."""
    runs, row_of_run, cell_of_run = raster.find_runs(cells)
    starts = raster.starts[runs].astype(np.int64)
    lengths = raster.stops[runs] - starts
    columns, rows = list_ranges(starts, lengths), np.repeat(row_of_run, lengths)
    return np.stack([columns, rows], axis=1).astype(np.int64), np.repeat(cell_of_run, lengths)


def find_common_pixels(pixels: IntArray, others: IntArray) -> BoolArray:
    """Tell which pixels, columns and rows, (n, 2), are among others."""
    both = np.concatenate([pixels, others])
    if not len(both):
        return np.zeros(0, dtype=bool)
    low = both.min(axis=0)
    span = int(np.ptp(both[:, 0])) + 1
    return np.isin((pixels - low) @ (1, span), (others - low) @ (1, span))
