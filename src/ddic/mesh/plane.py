"""Points, vectors and polylines of the plane: cross product, the nearest of some points."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ddic.arrays import Array, BoolArray, IntArray

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


def compute_normals(vectors: Array) -> Array:
    """Turn vectors, (..., 2), by a right angle from x towards y: normals of a line from its tangents."""
    return np.stack([-vectors[..., 1], vectors[..., 0]], axis=-1)


def multiply_across(a: Array, b: Array) -> Array:
    """Multiply vectors of the plane across: a_x b_y - a_y b_x, twice the area of the triangle that they span.

    Positive where b lies to the side of +y from a along +x. Both are (..., 2), of shapes that broadcast.
    """
    ax, ay = a[..., 0], a[..., 1]
    bx, by = b[..., 0], b[..., 1]
    return np.asarray(ax * by - ay * bx)


def build_tree(points: Array) -> cKDTree:
    """Build the tree that finds the nearest of some points, (n, 2)."""
    # Here, for it brings a tenth of a second of scipy's imports, and most ranks and many runs do without.
    from scipy.spatial import cKDTree

    return cKDTree(points)


def measure_distance(points: Array, line: Array) -> Array:
    """Measure the distance of points, (n, 2), from the nearest place on a polyline, (n_vertices, 2), pixels."""
    return find_nearest_segments(points, line)[1]


def find_nearest_segments(points: Array, line: Array) -> tuple[IntArray, Array]:
    """Find the number of the polyline's segment nearest to each point, (n,), and the distance from it, (n,), pixels."""
    nearest = np.zeros(len(points), dtype=np.int64)
    least = np.full(len(points), np.inf)
    for number, (start, end) in enumerate(pairwise(line)):
        along = end - start
        share = np.clip((points - start) @ along / max(float(along @ along), 1e-300), 0.0, 1.0)
        distance = np.linalg.norm(points - start - share[:, None] * along, axis=1)
        nearer = distance < least
        nearest[nearer] = number
        least[nearer] = distance[nearer]
    return nearest, least


def subdivide(line: Array, longest: float) -> Array:
    """Subdivide the segments of a polyline, (n_vertices, 2), so that none is longer than ``longest``, pixels."""
    vertices = [line[:1]]
    for start, end in pairwise(line):
        n_segments = max(1, int(np.ceil(np.linalg.norm(end - start) / longest)))
        shares = np.arange(1, n_segments + 1) / n_segments
        vertices.append(start + shares[:, None] * (end - start))
    return np.concatenate(vertices)


def find_runs(is_kept: BoolArray) -> list[slice]:
    """Find the runs of two or more successive vertices that are kept."""
    changes = np.flatnonzero(np.diff(np.concatenate([[False], is_kept, [False]])))
    runs = [slice(int(start), int(stop)) for start, stop in changes.reshape(-1, 2)]
    return [run for run in runs if run.stop - run.start > 1]


PAIRS_AT_ONCE = 1 << 22
"""Pairs of a point and an edge that are compared at once; a larger value takes more memory."""


def is_inside_edges(points: Array, edges: Array) -> BoolArray:
    """Tell which points, (n, 2), a ray to the right of which crosses an odd number of edges, (m, 2 ends, 2)."""
    (x0, y0), (x1, y1) = edges[:, 0].T, edges[:, 1].T
    height = np.where(y1 == y0, 1.0, y1 - y0)
    inside = np.zeros(len(points), dtype=bool)
    step = max(1, PAIRS_AT_ONCE // max(len(edges), 1))
    for begin in range(0, len(points), step):
        # Points down the rows, edges along the columns.
        x, y = points[begin:begin + step].T[..., None]
        # Half-open, so that a ray through a common end crosses one of two edges that go on, and none or both at a tip.
        spans = (y0 > y) != (y1 > y)
        crossing = x0 + (y - y0) * (x1 - x0) / height
        inside[begin:begin + step] = (spans & (crossing > x)).sum(axis=1) % 2 == 1
    return inside


def is_inside_polygon(points: Array, polygon: Array) -> BoolArray:
    """Tell which points lie in a polygon, (n_corners, 2), convex or not, by the parity of edges to their right."""
    x, y = points.T
    inside = np.zeros(len(points), dtype=bool)
    for (x0, y0), (x1, y1) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if y0 == y1:
            continue
        crosses = (y0 <= y) != (y1 <= y)
        inside ^= crosses & (x < x0 + (y - y0) / (y1 - y0) * (x1 - x0))
    return inside


def is_simple_polygon(vertices: Array) -> bool:
    """Tell whether sides of a closed polygon, (n, 2), no vertex twice in a row, meet at their common vertex only."""
    starts, ends = vertices, np.roll(vertices, -1, axis=0)
    sides = ends - starts
    following = np.roll(sides, -1, axis=0)
    runs_back = (multiply_across(sides, following) == 0) & ((sides * following).sum(axis=1) < 0)
    if runs_back.any():
        return False
    low, high = np.minimum(starts, ends), np.maximum(starts, ends)
    for k in range(len(vertices) - 2):
        # Later sides but the neighbours; the last one is a neighbour of the first.
        others = slice(k + 2, len(vertices) - (k == 0))
        # Their ends lie on both sides of this one or on it, and the other way round.
        parts = (multiply_across(sides[k], starts[others] - starts[k])
                 * multiply_across(sides[k], ends[others] - starts[k]) <= 0)
        is_parted = (multiply_across(sides[others], starts[k] - starts[others])
                     * multiply_across(sides[others], ends[k] - starts[others]) <= 0)
        is_near = ((low[others] <= high[k]) & (high[others] >= low[k])).all(axis=1)
        if (parts & is_parted & is_near).any():
            return False
    return True
