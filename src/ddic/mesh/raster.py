"""Rasterisation: every pixel centre belongs to exactly one cell.

A pixel centre (x, y) belongs to the cell whose row y holds x_left <= x < x_right, where the ends are
the crossings of the row with the cell's edges. An edge from a to b crosses the rows y_a <= y < y_b.
Both neighbours of an edge compute its crossings from the same two nodes in the same order, hence get
the same floating-point number, hence share no pixel and leave none.

In a volume, faces of four nodes are two triangles along the diagonal from the node of the lowest number, whatever the
cell. A plane z cuts the edges from a to b with z_a <= z < z_b, hence the faces of a cell in closed polygons, whose
edges and rows are as above.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numba
import numpy as np
from numpy.typing import DTypeLike, NDArray

from ddic.arrays import Array, BoolArray, IntArray
from ddic.images.window import Window
from ddic.mesh.cell_parts import find_offsets, list_ranges
from ddic.mesh.mesh import Mesh

SNAP = float(2**20)
"""Crossings are rounded to multiples of 1/SNAP px, so that rounding errors where two edges meet cannot fall on
different sides of a pixel centre; a larger value rounds less and forgives less."""

LISTED_PIXELS = 1 << 20
"""Pixels that are listed at a time where a list of all would take more memory than images do."""

BAND_PIXELS = 1 << 24
"""Pixels that are looked at together where cells may overlap; a larger value takes memory."""


@dataclass(frozen=True)
class Raster:
    """Runs of pixels of every cell, row by row; in a volume plane by plane.

    Attributes
    ----------
    first_rows : (n_cells, dim - 1) int64 array
        Where the rows of each cell begin: y, in a volume y and z.
    n_rows : (n_cells, dim - 1) int64 array
        Number of rows along y and z. Where all have been gone through, they are begun again: rows of a cell of which
        faces are not plane may have two runs.
    row_ptr : (n_cells + 1,) int64 array
        Cell e owns runs row_ptr[e]:row_ptr[e + 1].
    starts, stops : (n_runs,) int32 arrays
        Half-open columns of each run (may be empty).
    """

    first_rows: IntArray
    n_rows: IntArray
    row_ptr: IntArray
    starts: NDArray[np.int32]
    stops: NDArray[np.int32]

    @cached_property
    def pixel_counts(self) -> IntArray:
        """Number of pixels of each cell, (n_cells,)."""
        up_to = find_offsets(self.stops - self.starts)
        return np.asarray(up_to[self.row_ptr[1:]] - up_to[self.row_ptr[:-1]])

    @cached_property
    def window(self) -> Window:
        """Bounding box of all pixels; raises ValueError where there is none."""
        filled = self.stops > self.starts
        if not filled.any():
            raise ValueError("no pixel centre lies inside the mesh")
        if self.first_rows.shape[1] == 1:
            rows = self.find_runs(np.arange(len(self.n_rows)))[1][filled]
            first, stop = rows.min(axis=0), rows.max(axis=0) + 1
        else:
            # A list of the rows of all runs would take more than the voxels.
            first, stop = self.first_rows.min(axis=0), (self.first_rows + self.n_rows).max(axis=0)
        return Window.between([self.starts[filled].min(), *first], [self.stops[filled].max(), *stop])

    def draw_cells(self, cells: IntArray, window: Window) -> NDArray[np.uint8]:
        """Draw the pixels of some cells in a window: 1 there, 0 elsewhere."""
        n_cells = self._count_cells(cells, window, np.uint8)
        return np.minimum(n_cells, 1, out=n_cells)

    def find_shared(self, extent: Window) -> IntArray:
        """Count the pixels of each cell that other cells hold too, (n_cells,); ``extent`` has all pixels."""
        shared = np.zeros(len(self.n_rows), dtype=np.int64)
        for band in extent.split_rows(max(1, BAND_PIXELS * extent.sizes[-1] // extent.n_pixels)):
            n_cells = self._count_cells(np.arange(len(shared)), band, np.uint16)
            shared += self.sum_by_cell((n_cells > 1).astype(np.uint8), band)
        return shared

    def _count_cells(self, cells: IntArray, window: Window, dtype: DTypeLike) -> NDArray[Any]:
        """Count those of some cells that hold each pixel of a window."""
        first, n_rows = self.first_rows[cells, -1], self.n_rows[cells, -1]
        runs, rows, _ = self.find_runs(cells[(first < window.upper[-1]) & (first + n_rows > window.lower[-1])])
        rows = rows - window.lower[1:]
        inside = ((rows >= 0) & (rows < window.sizes[1:])).all(axis=1)
        starts, stops = (np.clip(ends[runs[inside]] - window.x0, 0, window.width) for ends in (self.starts, self.stops))
        n_cells = np.zeros(window.shape, dtype=dtype)
        _add_ones(np.ravel_multi_index(rows[inside].T[::-1], window.shape[:-1]), starts, stops,
                  n_cells.reshape(-1, window.width))
        return n_cells

    def find_runs(self, cells: IntArray) -> tuple[IntArray, IntArray, IntArray]:
        """Find the runs of some cells: numbers, (n_runs,), rows, (n_runs, dim - 1), and cells, (n_runs,)."""
        n_runs = np.diff(self.row_ptr)[cells]
        runs = list_ranges(self.row_ptr[cells], n_runs)
        of_runs = np.repeat(cells, n_runs)
        left, rows = runs - self.row_ptr[of_runs], np.empty((len(runs), self.n_rows.shape[1]), dtype=np.int64)
        for axis, n_rows in enumerate(self.n_rows[of_runs].T):
            left, rows[:, axis] = np.divmod(left, n_rows)
        return runs, rows + self.first_rows[of_runs], of_runs

    def sum_by_cell(self, image: NDArray[Any], window: Window) -> NDArray[Any]:
        """Add up an image on a window over each cell's pixels; nothing outside of it counts.

        Sums, (n_cells,), are int64 for an image of integers, else float64.
        """
        is_counted = np.issubdtype(image.dtype, np.integer)
        sums = np.zeros(len(self.n_rows), dtype=np.int64 if is_counted else np.float64)
        # An image is the only plane of a volume.
        missing = (0, 0), (0, 3 - image.ndim)
        first_rows, n_rows = np.pad(self.first_rows, missing), np.pad(self.n_rows, missing, constant_values=1)
        _add_up(image[(None,) * (3 - image.ndim)], (*window.lower, 0)[:3], first_rows, n_rows, self.row_ptr,
                self.starts, self.stops, sums)
        return sums


def rasterize(mesh: Mesh) -> Raster:
    """Find the pixels of every cell; cells must be convex, with straight edges."""
    if mesh.dim == 3:
        # Planes cut edges at rounded places, which must not leave the rows between a cell's nodes.
        mesh = replace(mesh, nodes=np.round(mesh.nodes * SNAP) / SNAP)
    outlines = mesh.outlines
    at_corners = outlines.corners[outlines.connectivity, 1:]
    first_rows = np.ceil(np.minimum.reduceat(at_corners, outlines.offsets[:-1])).astype(np.int64)
    last_rows = np.ceil(np.maximum.reduceat(at_corners, outlines.offsets[:-1])).astype(np.int64)
    n_rows = np.maximum(last_rows - first_rows, 0)
    if mesh.dim == 3:
        return _rasterize_volume(mesh, first_rows, n_rows)
    row_ptr = find_offsets(n_rows[:, 0])
    starts, stops = np.empty((2, row_ptr[-1]), dtype=np.int32)
    _fill_runs(*outlines, first_rows[:, 0], row_ptr, starts, stops)
    return Raster(first_rows, n_rows, row_ptr, starts, stops)


def _rasterize_volume(mesh: Mesh, first_rows: IntArray, n_rows: IntArray) -> Raster:
    """Find the runs of voxels between the faces of each cell."""
    times = np.ones(mesh.n_cells, dtype=np.int64)
    cells = (mesh.nodes, *_list_triangles(mesh), first_rows, n_rows, times)
    _fill_volume_runs(*cells, np.zeros(1, np.int64), *np.zeros((2, 0), dtype=np.int32))
    row_ptr = find_offsets(times * n_rows.prod(axis=1))
    starts, stops = np.zeros((2, row_ptr[-1]), dtype=np.int32)
    _fill_volume_runs(*cells, row_ptr, starts, stops)
    return Raster(first_rows, n_rows, row_ptr, starts, stops)


def _list_triangles(mesh: Mesh) -> tuple[IntArray, IntArray]:
    """List the triangles that the cells' faces are made of, cell after cell: their nodes, and where each cell begins.

    A face of four nodes is halved along the diagonal from that of the lowest number: by both cells alike, and in a part
    of the mesh as in the whole.
    """
    triangles, cells = [], []
    for block in mesh.cell_blocks:
        for facet in block.type.facets:
            nodes = block.nodes[:, facet]
            lowest = nodes.argmin(axis=1)
            for k in range(1, len(facet) - 1):
                turned = (lowest[:, None] + np.array([0, k, k + 1])) % len(facet)
                triangles.append(np.take_along_axis(nodes, turned, axis=1))
                cells.append(block.cells)
    order = np.argsort(np.concatenate(cells), kind="stable")
    n_triangles = np.bincount(np.concatenate(cells), minlength=mesh.n_cells)
    return np.concatenate(triangles)[order], find_offsets(n_triangles)


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


MOST_CROSSINGS = 12
"""Of a row with the faces of a cell: one with each triangle."""


@numba.njit(cache=True)
def _cut_edge(nodes, a, b, axis, at):  # type: ignore[no-untyped-def]
    """Where the edge between two nodes, one of them not above a plane across an axis, crosses it."""
    if nodes[a, axis] > nodes[b, axis]:
        a, b = b, a
    share = (at - nodes[a, axis]) / (nodes[b, axis] - nodes[a, axis])
    x = nodes[a, 0] + share * (nodes[b, 0] - nodes[a, 0])
    y = nodes[a, 1] + share * (nodes[b, 1] - nodes[a, 1])
    return x, np.round(y * SNAP) / SNAP


@numba.njit(cache=True)
def _cross_rows(nodes, triangles, first, n, crossings, n_crossings):  # type: ignore[no-untyped-def]
    """Find where rows cross the triangles of a cell: columns, (n_y n_z, MOST_CROSSINGS), and how many of each row."""
    n_crossings[:n[0] * n[1]] = 0
    for t in range(len(triangles)):
        a, b, c = triangles[t]
        lowest = min(nodes[a, 2], nodes[b, 2], nodes[c, 2])
        highest = max(nodes[a, 2], nodes[b, 2], nodes[c, 2])
        for z in range(np.int64(np.ceil(lowest)), np.int64(np.ceil(highest))):
            # Of three nodes, two are on one side: the plane cuts the edges from the third one.
            a_below, b_below, c_below = nodes[a, 2] <= z, nodes[b, 2] <= z, nodes[c, 2] <= z
            if b_below == c_below:
                apex, one, other = a, b, c
            elif a_below == c_below:
                apex, one, other = b, a, c
            else:
                apex, one, other = c, a, b
            x_low, y_low = _cut_edge(nodes, apex, one, 2, z)
            x_high, y_high = _cut_edge(nodes, apex, other, 2, z)
            if y_low > y_high:
                x_low, y_low, x_high, y_high = x_high, y_high, x_low, y_low
            for y in range(np.int64(np.ceil(y_low)), np.int64(np.ceil(y_high))):
                x = x_low + (y - y_low) / (y_high - y_low) * (x_high - x_low)
                row = (z - first[1]) * n[0] + y - first[0]
                crossings[row, n_crossings[row]] = np.int64(np.ceil(np.round(x * SNAP) / SNAP))
                n_crossings[row] += 1


@numba.njit(cache=True)
def _fill_volume_runs(nodes, triangles, ends, first_rows, n_rows, times,  # type: ignore[no-untyped-def]
                      row_ptr, starts, stops):
    """Fill the runs between every two crossings of a row, and count how many a row of each cell has, the most."""
    most = np.max(n_rows[:, 0] * n_rows[:, 1])
    crossings, n_crossings = np.empty((most, MOST_CROSSINGS), np.int64), np.empty(most, np.int64)
    for e in range(len(n_rows)):
        _cross_rows(nodes, triangles[ends[e]:ends[e + 1]], first_rows[e], n_rows[e], crossings, n_crossings)
        of_cell = n_rows[e, 0] * n_rows[e, 1]
        for row in range(of_cell):
            times[e] = max(times[e], n_crossings[row] // 2)
            if len(starts) == 0:
                continue
            columns = np.sort(crossings[row, :n_crossings[row]])
            for k in range(len(columns) // 2):
                run = row_ptr[e] + k * of_cell + row
                starts[run], stops[run] = columns[2 * k], columns[2 * k + 1]


@numba.njit(cache=True)
def _add_up(image, lower, first_rows, n_rows, row_ptr, starts, stops, sums):  # type: ignore[no-untyped-def]
    """Add each cell's pixels of an image, (depth, height, width), to its sum."""
    depth, height, width = image.shape
    for e in range(len(first_rows)):
        # Of a volume's cells few reach into a slab.
        if first_rows[e, 1] >= lower[2] + depth or first_rows[e, 1] + n_rows[e, 1] <= lower[2]:
            continue
        total = sums[e]
        for r in range(row_ptr[e], row_ptr[e + 1]):
            k = r - row_ptr[e]
            y = first_rows[e, 0] + k % n_rows[e, 0] - lower[1]
            z = first_rows[e, 1] + k // n_rows[e, 0] % n_rows[e, 1] - lower[2]
            if 0 <= y < height and 0 <= z < depth:
                for x in range(max(starts[r] - lower[0], 0), min(stops[r] - lower[0], width)):
                    total += image[z, y, x]
        sums[e] = total


@numba.njit(cache=True)
def _add_ones(rows, starts, stops, image):  # type: ignore[no-untyped-def]
    """Add 1 to the pixels of some runs."""
    for k in range(len(rows)):
        for x in range(starts[k], stops[k]):
            image[rows[k], x] += 1


def list_pixels(raster: Raster, cells: IntArray) -> tuple[IntArray, IntArray]:
    """List the pixels of some cells, (n, dim), columns before rows, and the cell of each, (n,)."""
    runs, row_of_run, cell_of_run = raster.find_runs(cells)
    starts = raster.starts[runs].astype(np.int64)
    lengths = raster.stops[runs] - starts
    columns, rows = list_ranges(starts, lengths), np.repeat(row_of_run, lengths, axis=0)
    return np.column_stack([columns, rows]).astype(np.int64), np.repeat(cell_of_run, lengths)


def list_pixels_in_turn(raster: Raster, cells: IntArray) -> Iterator[tuple[IntArray, IntArray]]:
    """List the pixels of some cells as ``list_pixels`` does, those of a few cells at a time."""
    turns = np.cumsum(raster.pixel_counts[cells]) // LISTED_PIXELS
    for some in np.split(cells, np.flatnonzero(np.diff(turns)) + 1):
        yield list_pixels(raster, some)


def find_common_pixels(pixels: IntArray, others: IntArray) -> BoolArray:
    """Tell which pixels, (n, dim), are among others."""
    both = np.concatenate([pixels, others])
    if not len(both):
        return np.zeros(0, dtype=bool)
    low, sizes = both.min(axis=0), np.ptp(both, axis=0) + 1
    numbers, of_others = (np.ravel_multi_index((some - low).T, sizes) for some in (pixels, others))
    return np.isin(numbers, of_others)
