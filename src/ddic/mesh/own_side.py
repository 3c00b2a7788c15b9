"""A point on its own side of a discontinuity for each node: phantom nodes lie on the other one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.mesh import Mesh


def find_points_on_own_side(mesh: Mesh) -> NDArray[np.float64]:
    """Find a point for each node at which a field on the node's side of all lines can be looked up.

    Parameters
    ----------
    mesh : Mesh
        Perhaps with parts of cut cells.

    Returns
    -------
    (n_nodes, 2) array
        The node itself or, where none of its parts holds it, the middle of the nearest of them, pixels.
    """
    points = mesh.nodes.copy()
    if mesh.parts is None or not mesh.parts.n_parts:
        return points
    parts = mesh.parts
    least = np.full(mesh.n_nodes, np.inf)
    for number, cell in enumerate(parts.cells):
        corners = parts.corners[parts.offsets[number]:parts.offsets[number + 1]]
        own = mesh.cells[cell]
        for node in own[own >= 0]:
            is_held = (corners == mesh.nodes[node]).all(axis=1).any()
            point = mesh.nodes[node] if is_held else corners.mean(axis=0)
            distance = float(np.linalg.norm(point - mesh.nodes[node]))
            if distance < least[node]:
                points[node], least[node] = point, distance
    return points
