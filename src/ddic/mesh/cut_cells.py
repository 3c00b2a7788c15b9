"""Cells cut by polylines: the chords in a cell, and the convex polygons into which these cut it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.plane import multiply_across

INNER = -1
"""In place of a side or a node of the cell: an edge along a chord, a corner where a chord ends."""

SHORTEST = 1e-9
"""Length, pixels, below which a chord in a polygon cuts nothing off."""

Point = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Polygon:
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

    corners: NDArray[np.float64]
    nodes: tuple[int, ...]
    sides: tuple[int, ...]

    @classmethod
    def of_cell(cls, corners: NDArray[np.float64]) -> Polygon:
        """Take a whole cell, whose side k runs from node k to the next one.

        Parameters
        ----------
        corners : (n, 2) array
            Of the cell, in positive order, pixels.

        Returns
        -------
        Polygon
            All of it.
        """
        numbers = tuple(range(len(corners)))
        return cls(corners, numbers, numbers)

    def cut(self, chord: Chord) -> tuple[Polygon, ...]:
        """Cut the polygon by a chord of its cell.

        Parameters
        ----------
        chord : Chord
            Cuts straight, whatever its bends.

        Returns
        -------
        tuple of Polygon
            To the right and to the left of the chord; the polygon itself where the chord misses it.
        """
        along = chord.end - chord.start
        length = float(np.linalg.norm(along))
        if length <= SHORTEST:
            # A line that turns back where it enters.
            return (self,)
        heights = multiply_across(along / length, self.corners - chord.start)
        if heights.max() <= SHORTEST or heights.min() >= -SHORTEST:
            return (self,)
        return self._keep(-heights), self._keep(heights)

    def _keep(self, heights: NDArray[np.float64]) -> Polygon:
        """The part where heights, of the corners above a line, are positive."""
        corners, nodes, sides = [], [], []
        for k in range(len(heights)):
            following = (k + 1) % len(heights)
            here, there = heights[k], heights[following]
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
                leaves = here > 0
                sides.append(INNER if leaves else self.sides[k])
        return Polygon(np.array(corners), tuple(nodes), tuple(sides))


@dataclass(frozen=True, eq=False)
class Chord:
    """Where a polyline crosses a cell from side to side.

    Attributes
    ----------
    start, end : (2,) array
        Ends, on the outline of the cell, pixels.
    bends : (n, 2) array
        Vertices of the polyline between them, pixels.
    """

    start: Point
    end: Point
    bends: NDArray[np.float64]


def find_chords(corners: NDArray[np.float64], line: NDArray[np.float64]) -> list[Chord]:
    """Find where a polyline crosses a convex cell from side to side; an end inside the cell cuts nothing.

    Parameters
    ----------
    corners : (n, 2) array
        Of the cell, in positive order, pixels.
    line : (n_vertices, 2) array
        Vertices of the polyline, none of them on the outline, pixels.

    Returns
    -------
    list of Chord
        Along the line.
    """
    chords = []
    is_inside = _is_inside(corners, line[0])
    entry: Point | None = None
    bends: list[Point] = []
    for start, end in pairwise(line):
        for _, point in sorted(_cross_outline(corners, start, end), key=lambda crossing: crossing[0]):
            is_inside = not is_inside
            if is_inside:
                entry, bends = point, []
            elif entry is not None:
                chords.append(Chord(entry, point, np.array(bends).reshape(-1, 2)))
        bends.append(end)
    return chords


def _is_inside(corners: NDArray[np.float64], point: Point) -> bool:
    edges = np.roll(corners, -1, axis=0) - corners
    return bool((multiply_across(edges, point - corners) > 0).all())


def _cross_outline(corners: NDArray[np.float64], start: Point, end: Point) -> list[tuple[float, Point]]:
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
