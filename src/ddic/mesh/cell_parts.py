"""Cells of which only a part counts: a discontinuity cuts them, and each side is a cell of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ddic.arrays import Array, IntArray
from ddic.mesh.plane import multiply_across

_A, _B = 0.445948490915965, 0.091576213509771
TRIANGLE_POINTS = np.array([[1 - 2 * x, x, x] for x in (_A, _B)] + [[x, 1 - 2 * x, x] for x in (_A, _B)]
                           + [[x, x, 1 - 2 * x] for x in (_A, _B)])
TRIANGLE_WEIGHTS = np.tile([0.223381589678011, 0.109951743655322], 3)
"""Six points of a triangle, by their shares of its corners, and their weights: exact for polynomials of degree 4."""


def find_offsets(counts: IntArray) -> IntArray:
    """Find where each of some lists begins that follow each other, and where the last one ends, from their lengths."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def list_ranges(first: IntArray, counts: IntArray) -> IntArray:
    """List numbers range after range: ``counts`` of them each, from the ``first`` on."""
    begins = np.cumsum(counts) - counts
    return np.asarray(np.arange(counts.sum()) + np.repeat(first - begins, counts))


@dataclass(frozen=True, eq=False)
class Lines:
    """Discontinuities, and what a mesh makes of their bends.

    Attributes
    ----------
    polylines : tuple of (n_vertices, 2) array
        Pixels.
    bends : tuple of (n, 2) array
        Polygons between a polyline that bends inside a cell and the straight line that cuts the cell, pixels: what
        lies in them is on the wrong side.
    """

    polylines: tuple[Array, ...]
    bends: tuple[Array, ...] = ()


@dataclass(frozen=True, eq=False)
class CellParts:
    """Outlines of the cells that are parts, and the lines that cut them.

    Attributes
    ----------
    cells : (n,) int64 array
        Their numbers in the mesh, sorted.
    offsets : (n + 1,) int64 array
        Part k has the corners offsets[k]:offsets[k + 1].
    corners : (n_corners, 2) array
        Corners of the convex outlines, one after the other in positive order, pixels.
    first_numbers : (n,) int64 array
        Number of each part's first corner in the whole mesh; the others follow.
    lines : Lines
        The discontinuities.
    """

    cells: IntArray
    offsets: IntArray
    corners: Array
    first_numbers: IntArray
    lines: Lines

    @property
    def n_parts(self) -> int:
        """Number of cells that are parts."""
        return len(self.cells)

    def restrict(self, cells: IntArray) -> CellParts:
        """Keep the parts among some cells, numbered anew in this order; all lines stay, for cells beside them."""
        found = np.searchsorted(self.cells, cells)
        is_part = found < len(self.cells)
        is_part[is_part] = self.cells[found[is_part]] == cells[is_part]
        kept = found[is_part]
        counts = np.diff(self.offsets)[kept]
        corners = self.corners[list_ranges(self.offsets[kept], counts)]
        return CellParts(np.flatnonzero(is_part).astype(np.int64), find_offsets(counts), corners,
                         self.first_numbers[kept], self.lines)


def join_cell_parts(of_meshes: Sequence[tuple[CellParts, int]]) -> CellParts:
    """Put the parts of several meshes, cut by the same lines, into one list, as ``join_meshes`` does with their cells.

    Beside the parts of each mesh is the number that its first cell takes. Corners are numbered anew.
    """
    cells = np.concatenate([parts.cells + first_cell for parts, first_cell in of_meshes])
    offsets = find_offsets(np.concatenate([np.diff(parts.offsets) for parts, _ in of_meshes]))
    corners = np.concatenate([parts.corners for parts, _ in of_meshes])
    return CellParts(cells, offsets, corners, offsets[:-1], of_meshes[0][0].lines)


class Outlines(NamedTuple):
    """What each cell covers: in the plane a convex polygon. The one way from cells to places, which kernels take too.

    Attributes
    ----------
    corners : (n_corners, 2) array
        Pixels.
    connectivity : (sum of corners per cell,) int64 array
        Corners of the cells, one cell after the other.
    offsets : (n_cells + 1,) int64 array
        Cell e has connectivity[offsets[e]:offsets[e + 1]].
    """

    corners: Array
    connectivity: IntArray
    offsets: IntArray

    def find_boxes(self) -> tuple[Array, Array]:
        """Find the lowest and the highest coordinates of each cell's corners, (n_cells, 2) each, pixels."""
        at_corners = self.corners[self.connectivity]
        return (np.minimum.reduceat(at_corners, self.offsets[:-1], axis=0),
                np.maximum.reduceat(at_corners, self.offsets[:-1], axis=0))


def join_parts(whole: Outlines, parts: CellParts) -> Outlines:
    """Put the outlines of parts in place of those of the cells that they are parts of."""
    first, counts = whole.offsets[:-1].copy(), np.diff(whole.offsets)
    # Those of parts are listed after those of all cells.
    first[parts.cells] = len(whole.connectivity) + parts.offsets[:-1]
    counts[parts.cells] = np.diff(parts.offsets)
    of_both = np.concatenate([whole.connectivity, len(whole.corners) + np.arange(len(parts.corners))])
    connectivity = of_both[list_ranges(first, counts)]
    return Outlines(np.concatenate([whole.corners, parts.corners]), connectivity, find_offsets(counts))


def place_quadrature_points(parts: CellParts) -> tuple[Array, Array, IntArray]:
    """Place the points of a rule of integration over the parts, each cut into triangles about its first corner.

    Gives points, (n, 2), pixels, their weights, which are areas in square pixels, and the number of the part of each,
    sorted. Outlines are convex.
    """
    n_triangles = np.diff(parts.offsets) - 2
    numbers = np.repeat(np.arange(len(parts.cells)), n_triangles)
    apex, second = parts.offsets[numbers], list_ranges(parts.offsets[:-1] + 1, n_triangles)
    triangles = parts.corners[np.stack([apex, second, second + 1], axis=1)]
    areas = 0.5 * multiply_across(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    points = np.einsum("pa,tac->tpc", TRIANGLE_POINTS, triangles).reshape(-1, 2)
    weights = (areas[:, None] * TRIANGLE_WEIGHTS).ravel()
    return points, weights, np.repeat(numbers, len(TRIANGLE_WEIGHTS))
