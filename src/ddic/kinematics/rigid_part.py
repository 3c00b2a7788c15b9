"""The rigid motion in a displacement, what is left without it, and how far that can be magnified."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import build_rotation, multiply_across
from ddic.mesh.topology import list_corners

Array = NDArray[np.float64]


def project_rigid_motion_out(points: Array, displacement: Array) -> Array:
    """Take the rotation and the translation that fit best out of a displacement.

    Parameters
    ----------
    points : (n, 2) array
        Where it is known.
    displacement : (n, 2) array
        Of any size, of the points' unit.

    Returns
    -------
    (n, 2) array
        What is left, in the axes at rest: R^T (x + u - c') - (x - c) with the rotation R and the centres c and c' of
        the points before and after.
    """
    before = points - points.mean(axis=0)
    after = points + displacement
    after = after - after.mean(axis=0)
    cosine = (before * after).sum()
    sine = multiply_across(before, after).sum()
    rotation = build_rotation(np.arctan2(sine, cosine))
    return np.asarray(after @ rotation - before)


def find_largest_gradient(mesh: Mesh, displacement: Array) -> float:
    """Find the largest stretch or shear at the corners of all cells: the largest singular value of grad u.

    Below 1 / that, no factor on the displacement turns a corner inside out.

    Parameters
    ----------
    mesh : Mesh
        Of plane cells.
    displacement : (n_nodes, 2) array
        Of the nodes' unit.

    Returns
    -------
    float
        No unit.
    """
    one, other = _list_edges(mesh, mesh.nodes)
    to_one, to_other = _list_edges(mesh, displacement)
    edges = np.stack([one, other], axis=2)
    gradients = np.stack([to_one, to_other], axis=2) @ np.linalg.inv(edges)
    return float(np.linalg.norm(gradients, ord=2, axis=(1, 2)).max())


def count_folded_cells(mesh: Mesh, moved: Array) -> int:
    """Count the cells with a corner that is flat or inside out.

    Parameters
    ----------
    mesh : Mesh
        Of plane cells that run positively.
    moved : (n_nodes, 2) array
        Where its nodes are.

    Returns
    -------
    int
        Their number.
    """
    folded = multiply_across(*_list_edges(mesh, moved)) <= 0
    return int(np.logical_or.reduceat(folded, mesh.offsets[:-1]).sum())


def _list_edges(mesh: Mesh, values: Array) -> tuple[Array, Array]:
    """Differences of nodal values from each corner of each cell to the next one and to the one before, (n, 2) each."""
    corners = list_corners(mesh)
    at_corners = values[corners.nodes]
    return values[corners.ahead] - at_corners, values[corners.behind] - at_corners
