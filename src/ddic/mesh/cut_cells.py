"""Cells cut by polylines: the chords in a cell, and the convex polygons into which these cut it.

Cells cut into many small ones of the same type, each with nodes of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ddic.arrays import Array, IntArray
from ddic.mesh.cell_type import CELL_TYPES, T3, CellType
from ddic.mesh.mesh import Mesh, build_mesh
from ddic.mesh.plane import multiply_across

INNER = -1
"""In place of a side or a node of the cell: an edge along a chord, a corner where a chord ends."""

SHORTEST = 1e-9
"""Length, pixels, below which a chord in a polygon cuts nothing off."""

@dataclass(frozen=True, eq=False)
class CellPolygon:
    """A convex polygon that is a cell, or a part of one.

    Attributes
    ----------
    corners : (n, 2) array
        In positive order, pixels.
    nodes : tuple of int
        Place in the cell of the node at each corner, INNER where there is none.
    sides : tuple of int
        Side of the cell on which the edge from each corner to the next lies, INNER where it is along a chord.
    """

    corners: Array
    nodes: tuple[int, ...]
    sides: tuple[int, ...]

    def cut(self, chord: Array) -> tuple[CellPolygon, ...]:
        """Cut the polygon straight from end to end of a chord of its cell, whatever its bends.

        Gives the part to the right and the part to the left of the chord; the polygon itself where the chord misses it.
        """
        along = chord[-1] - chord[0]
        length = float(np.linalg.norm(along))
        if length <= SHORTEST:
            # A line that turns back where it enters.
            return (self,)
        heights = multiply_across(along / length, self.corners - chord[0])
        if heights.max() <= SHORTEST or heights.min() >= -SHORTEST:
            return (self,)
        return self._keep(-heights), self._keep(heights)

    def _keep(self, heights: Array) -> CellPolygon:
        """The part where heights, of the corners above a line, are positive."""
        corners, nodes, sides = [], [], []
        for k, here in enumerate(heights):
            following = (k + 1) % len(heights)
            there = heights[following]
            if here > 0:
                corners.append(self.corners[k])
                nodes.append(self.nodes[k])
                sides.append(self.sides[k])
            if (here > 0) != (there > 0):
                # In the same order from either side, hence the same number for both parts and for the next cell.
                low, high = sorted((k, following), key=lambda n: tuple(self.corners[n]))
                share = heights[low] / (heights[low] - heights[high])
                corners.append(self.corners[low] + share * (self.corners[high] - self.corners[low]))
                nodes.append(INNER)
                # Where the outline leaves the part, its next edge runs along the chord.
                sides.append(INNER if here > 0 else self.sides[k])
        return CellPolygon(np.array(corners), tuple(nodes), tuple(sides))


def find_chords(corners: Array, line: Array) -> list[Array]:
    """Find where a polyline crosses a convex cell from side to side; an end inside the cell cuts nothing.

    Gives the pieces of the line in the cell, (n, 2) each, one after the other: their ends lie on its outline. The
    cell's corners are in positive order, and no vertex of the line lies on its outline; both are pixels.
    """
    chords = []
    edges = np.roll(corners, -1, axis=0) - corners
    is_inside = bool((multiply_across(edges, line[0] - corners) > 0).all())
    # Empty until the line has entered the cell.
    piece: list[Array] = []
    for start, end in pairwise(line):
        for _, point in sorted(_cross_outline(corners, start, end), key=lambda crossing: crossing[0]):
            is_inside = not is_inside
            if is_inside:
                piece = [point]
            elif piece:
                chords.append(np.array([*piece, point]))
        if piece:
            piece.append(end)
    return chords


def _cross_outline(corners: Array, start: Array, end: Array) -> list[tuple[float, Array]]:
    """Where a segment crosses the cell's sides: share of its length, and the point."""
    crossings = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        # In the same order from either cell, so that both find the same point.
        low, high = sorted((a, b), key=tuple)
        of_low = float(multiply_across(end - start, low - start))
        of_high = float(multiply_across(end - start, high - start))
        if (of_low > 0) == (of_high > 0):
            continue
        point = low + of_low / (of_low - of_high) * (high - low)
        along = float((point - start) @ (end - start) / ((end - start) @ (end - start)))
        if 0 <= along < 1:
            crossings.append((along, point))
    return crossings


def subdivide_cells(mesh: Mesh, cells: IntArray, longest: float) -> tuple[Mesh, IntArray]:
    """Cut whole T3 and Q4 cells into small ones; nodes on a side that two cells share are there twice.

    No side of a small cell is longer than ``longest`` pixels where cells are parallelograms. Gives the mesh of the
    small cells, and the cell that each of them lies in.
    """
    blocks: list[tuple[CellType, IntArray]] = []
    nodes: list[Array] = []
    cell_of: list[IntArray] = []
    n_nodes = 0
    for cell in cells:
        cell_type = CELL_TYPES[int(mesh.types[cell])]
        corners = mesh.nodes[mesh.get_cell(cell)]
        sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
        n = max(1, int(np.ceil(sides.max() / longest)))
        subdivide = _subdivide_triangle if cell_type is T3 else _subdivide_quadrilateral
        points, small = subdivide(corners, n)
        blocks.append((cell_type, small + n_nodes))
        nodes.append(points)
        cell_of.append(np.full(len(small), cell, dtype=np.int64))
        n_nodes += len(points)
    return build_mesh(np.concatenate(nodes), blocks), np.concatenate(cell_of)


def _subdivide_quadrilateral(corners: Array, n: int) -> tuple[Array, IntArray]:
    """Nodes ((n + 1)^2, 2) and cells (n^2, 4) of a grid in a quadrilateral, of n cells a side."""
    shares = np.arange(n + 1) / n
    below = _divide(corners[0], corners[1], shares)
    above = _divide(corners[3], corners[2], shares)
    rows = _divide(below, above, shares)
    numbers = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    cells = np.stack([numbers[:-1, :-1], numbers[:-1, 1:], numbers[1:, 1:], numbers[1:, :-1]], axis=-1)
    return rows.reshape(-1, 2), cells.reshape(-1, 4)


def _subdivide_triangle(corners: Array, n: int) -> tuple[Array, IntArray]:
    """Nodes and cells (n^2, 3) of a grid in a triangle, of n cells a side."""
    left = _divide(corners[0], corners[2], np.arange(n + 1) / n)
    right = _divide(corners[1], corners[2], np.arange(n + 1) / n)
    # One cell fewer in each row; the last is the triangle's third corner alone.
    n_of_rows = range(n, -1, -1)
    rows = [_divide(left[k], right[k], np.arange(n_of_row + 1) / max(n_of_row, 1))
            for k, n_of_row in enumerate(n_of_rows)]
    first = np.cumsum([0, *(len(row) for row in rows)])
    cells = []
    for k in range(n):
        here, beyond = first[k], first[k + 1]
        for i in range(n_of_rows[k]):
            cells.append([here + i, here + i + 1, beyond + i])
            if i + 1 < n_of_rows[k]:
                # Between two of those, the other way up.
                cells.append([here + i + 1, beyond + i + 1, beyond + i])
    return np.concatenate(rows), np.array(cells, dtype=np.int64)


def _divide(start: Array, end: Array, shares: Array) -> Array:
    """Points at shares of the way from start to end, one after the other: (n_shares, *start.shape).

    They lie exactly on a way along an axis and at its ends: a pixel there would else count twice, or not at all.
    """
    along = np.expand_dims(shares, tuple(range(1, start.ndim + 1)))
    return np.asarray(np.where(along == 1.0, end, start + along * (end - start)))
