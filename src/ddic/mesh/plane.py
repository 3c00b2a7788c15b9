"""Points and vectors of the plane: rotation, cross product, the nearest of some points.

Polylines in the plane.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


def build_rotation(angle: float) -> NDArray[np.float64]:
    """Build the matrix of a rotation of the plane.

    Parameters
    ----------
    angle : float
        From x towards y, radians.

    Returns
    -------
    (2, 2) array
        R, which turns a vector v to R v.
    """
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def multiply_across(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Multiply vectors of the plane across: a_x b_y - a_y b_x, twice the area of the triangle that they span.

    Parameters
    ----------
    a, b : (..., 2) arrays
        Of shapes that broadcast.

    Returns
    -------
    (...,) array
        Positive where b lies to the side of +y from a along +x.
    """
    ax, ay = a[..., 0], a[..., 1]
    bx, by = b[..., 0], b[..., 1]
    return np.asarray(ax * by - ay * bx)


def build_tree(points: NDArray[np.float64]) -> cKDTree:
    """Build the tree that finds the nearest of some points, (n, 2)."""
    # Here, for it brings a tenth of a second of scipy's imports, and most ranks and many runs do without.
    from scipy.spatial import cKDTree

    return cKDTree(points)


Array = NDArray[np.float64]


def measure_distance(points: Array, line: Array) -> Array:
    """Measure the distance of points from a polyline.

    Parameters
    ----------
    points : (n, 2) array
        Pixels.
    line : (n_vertices, 2) array
        Vertices, pixels.

    Returns
    -------
    (n,) array
        To the nearest point of any of its segments, pixels.
    """
    return find_nearest_segments(points, line)[1]


def find_nearest_segments(points: Array, line: Array) -> tuple[NDArray[np.int64], Array]:
    """Find the nearest segment of a polyline.

    Parameters
    ----------
    points : (n, 2) array
        Pixels.
    line : (n_vertices, 2) array
        Vertices, pixels.

    Returns
    -------
    segments : (n,) array of int64
        Number of the segment.
    distances : (n,) array
        From it, pixels.
    """
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
    """Subdivide the segments of a polyline.

    Parameters
    ----------
    line : (n_vertices, 2) array
        Vertices, pixels.
    longest : float
        Length that no segment is to exceed, pixels.

    Returns
    -------
    (n, 2) array
        The same line with more vertices.
    """
    vertices = [line[:1]]
    for start, end in pairwise(line):
        n_segments = max(1, int(np.ceil(np.linalg.norm(end - start) / longest)))
        shares = np.arange(1, n_segments + 1) / n_segments
        vertices.append(start + shares[:, None] * (end - start))
    return np.concatenate(vertices)


def find_runs(is_kept: NDArray[np.bool_]) -> list[slice]:
    """Find the runs of successive vertices that are kept.

    Parameters
    ----------
    is_kept : (n_vertices,) array of bool
        Whether each vertex of a polyline is.

    Returns
    -------
    list of slice
        Of two vertices or more each.
    """
    changes = np.flatnonzero(np.diff(np.concatenate([[False], is_kept, [False]])))
    runs = [slice(int(start), int(stop)) for start, stop in changes.reshape(-1, 2)]
    return [run for run in runs if run.stop - run.start > 1]


def is_inside_polygon(points: Array, polygon: Array) -> NDArray[np.bool_]:
    """Tell which points lie in a polygon, which need not be convex, by the parity of its edges to the right of them.

    Parameters
    ----------
    points : (n, 2) array
        Pixels.
    polygon : (n_corners, 2) array
        Corners, closed by itself, pixels.

    Returns
    -------
    (n,) array of bool
        Whether each does.
    """
    x, y = points.T
    inside = np.zeros(len(points), dtype=bool)
    for (x0, y0), (x1, y1) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if y0 == y1:
            continue
        crosses = (y0 <= y) != (y1 <= y)
        inside ^= crosses & (x < x0 + (y - y0) / (y1 - y0) * (x1 - x0))
    return inside
