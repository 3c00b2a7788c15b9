"""Whether points lie in a mesh, and in which of its cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.mesh import Mesh
from ddic.mesh.topology import boundary_facets

_CHUNK = 1 << 22


def inside_outline(points: NDArray[np.float64], mesh: Mesh) -> NDArray[np.bool_]:
    """Whether points (n, 2) lie inside a mesh's outline, (n,): a ray to the right crosses it an odd number of times."""
    ends = mesh.nodes[boundary_facets(mesh)[:, :2]]
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    inside = np.zeros(len(points), dtype=bool)
    near = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
    (x0, y0), (x1, y1) = ends[:, 0].T, ends[:, 1].T
    step = max(1, _CHUNK // max(len(ends), 1))
    for begin in range(0, len(near), step):
        x, y = points[near[begin: begin + step]].T[..., None]
        spans = (y0 > y) != (y1 > y)
        crossing = x0 + (y - y0) * (x1 - x0) / np.where(y1 == y0, 1.0, y1 - y0)
        inside[near[begin: begin + step]] = (spans & (crossing > x)).sum(axis=1) % 2 == 1
    return inside


def cells_with_points(mesh: Mesh, points: NDArray[np.float64], margin: float) -> NDArray[np.int64]:
    """Cells that hold any of points (n, 2) farther than ``margin`` from their edges; cells run positively."""
    found = np.zeros(mesh.n_cells, dtype=bool)
    low, high = points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)
    lowest = np.minimum.reduceat(mesh.nodes[mesh.connectivity], mesh.offsets[:-1], axis=0)
    highest = np.maximum.reduceat(mesh.nodes[mesh.connectivity], mesh.offsets[:-1], axis=0)
    for cell in np.flatnonzero(((lowest < high) & (highest > low)).all(axis=1)):
        corner = mesh.nodes[mesh.connectivity[mesh.offsets[cell]: mesh.offsets[cell + 1]]]
        candidates = points[((points > lowest[cell]) & (points < highest[cell])).all(axis=1)]
        along = np.roll(corner, -1, axis=0) - corner
        apart = candidates[:, None] - corner
        height = (along[:, 0] * apart[..., 1] - along[:, 1] * apart[..., 0]) / np.linalg.norm(along, axis=1)
        found[cell] = (height > margin).all(axis=1).any()
    return np.flatnonzero(found).astype(np.int64)
