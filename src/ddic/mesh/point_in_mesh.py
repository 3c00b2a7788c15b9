"""Whether points lie inside a mesh's outline, and which cells cover any of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import multiply_across
from ddic.mesh.topology import find_boundary_facets

_CHUNK = 1 << 22
"""Pairs of a point and an edge that are compared at once; a larger value takes more memory."""


def is_inside_outline(points: NDArray[np.float64], mesh: Mesh) -> NDArray[np.bool_]:
    """Tell whether points lie inside a mesh's outline: a ray to the right crosses it an odd number of times.

    Parameters
    ----------
    points : (n, 2) array
        Pixels.
    mesh : Mesh
        Of plane cells.

    Returns
    -------
    (n,) bool array
        False in its holes.
    """
    ends = find_boundary_facets(mesh)[:, :2]
    edges = mesh.nodes[ends]
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    # Points outside the bounding box need no ray.
    in_box = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
    inside = np.zeros(len(points), dtype=bool)
    step = max(1, _CHUNK // max(len(edges), 1))
    for begin in range(0, len(in_box), step):
        chunk = in_box[begin: begin + step]
        inside[chunk] = _count_crossings(points[chunk], edges) % 2 == 1
    return inside


def find_cells_with_points(mesh: Mesh, points: NDArray[np.float64], margin: float) -> NDArray[np.int64]:
    """Find the cells that hold any of some points well inside.

    Parameters
    ----------
    mesh : Mesh
        Of convex plane cells that run positively.
    points : (n, 2) array
        Pixels.
    margin : float
        Distance from a cell's edges beyond which a point counts, pixels.

    Returns
    -------
    (n,) int64 array
        Their sorted numbers.
    """
    corners = mesh.nodes[mesh.connectivity]
    lowest = np.minimum.reduceat(corners, mesh.offsets[:-1], axis=0)
    highest = np.maximum.reduceat(corners, mesh.offsets[:-1], axis=0)
    low, high = points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)
    near = ((lowest < high) & (highest > low)).all(axis=1)
    found = np.zeros(mesh.n_cells, dtype=bool)
    for cell in np.flatnonzero(near):
        in_box = ((points > lowest[cell]) & (points < highest[cell])).all(axis=1)
        own_corners = corners[mesh.offsets[cell]: mesh.offsets[cell + 1]]
        distances = _edge_distances(points[in_box], own_corners)
        well_inside = (distances > margin).all(axis=1)
        found[cell] = well_inside.any()
    return np.flatnonzero(found).astype(np.int64)


def _count_crossings(points: NDArray[np.float64], edges: NDArray[np.float64]) -> NDArray[np.int64]:
    """How many edges (m, 2 ends, 2) the rays from points (n, 2) to the right cross, (n,)."""
    x0, y0 = edges[:, 0].T
    x1, y1 = edges[:, 1].T
    # Points down the rows, edges along the columns.
    x, y = points[:, 0, None], points[:, 1, None]
    # Half-open, so that a ray through a common end crosses one of two edges that go on, and none or both at a tip.
    spans = (y0 > y) != (y1 > y)
    height = np.where(y1 == y0, 1.0, y1 - y0)
    crossing = x0 + (y - y0) * (x1 - x0) / height
    to_the_right = crossing > x
    return np.asarray((spans & to_the_right).sum(axis=1))


def _edge_distances(points: NDArray[np.float64], corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Signed distances (n, m) of points (n, 2) from the lines through a polygon's edges, positive inside."""
    along = np.roll(corners, -1, axis=0) - corners
    apart = points[:, None] - corners
    length = np.linalg.norm(along, axis=1)
    return np.asarray(multiply_across(along, apart) / length)
