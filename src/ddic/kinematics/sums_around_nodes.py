"""Sums over the cells around each node, from which the displacement gradient there is recovered."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.kinematics.strain import compute_displacement_gradients
from ddic.mesh.corners import Corners, list_corners
from ddic.mesh.covered_areas import measure_covered_areas
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import multiply_across

Array = NDArray[np.float64]

CELLS_AT_A_TIME, MOST_STEPS = 1 << 15, 32
"""Cells whose sums are made together (some 30 MB), and into how many parts a mesh is divided for that; larger values
take memory, or time."""

N_OF_CELLS, N_OF_TRIANGLES = 18, 11
"""Columns of what is summed over cells, and over the triangles at their corners."""


@dataclass(frozen=True, eq=False)
class SumsAroundNodes:
    """What is summed around each node, by name.

    Cells weigh by their areas: G is the gradient in a cell's middle, x goes there from the node. A triangle at a corner
    weighs by its own area.

    Attributes
    ----------
    area : (n_nodes,) array
        Of the cells, square pixels.
    middle : (n_nodes, 2) array
        Sum of x.
    squares : (n_nodes, 2, 2) array
        Sum of x x^T.
    gradient : (n_nodes, 2, 2) array
        Sum of G.
    moments : (n_nodes, 2, 2, 2) array
        Sum of G_cj x_k.
    triangle_area : (n_nodes,) array
        Of the triangles, square pixels.
    triangle_gradient : (n_nodes, 2, 2) array
        Sum of the triangles' gradients.
    triangle_curving : (n_nodes, 2, 3) array
        Sum of what curvatures (xx, xy, yy) of 1 / px add to the derivatives by x_j of a triangle, pixels.
    """

    area: Array
    middle: Array
    squares: Array
    gradient: Array
    moments: Array
    triangle_area: Array
    triangle_gradient: Array
    triangle_curving: Array

    @classmethod
    def from_columns(cls, columns: Array) -> SumsAroundNodes:
        """Name the columns of ``sum_around_nodes``.

        Parameters
        ----------
        columns : (n_nodes, N_OF_CELLS + N_OF_TRIANGLES) array
            Sums, of all meshes that share a node.

        Returns
        -------
        SumsAroundNodes
            The same numbers.
        """
        of_cells, of_triangles = columns[:, :N_OF_CELLS], columns[:, N_OF_CELLS:]
        # _weigh_cells and _weigh_triangles order them so.
        xx_xy_xy_yy = [3, 4, 4, 5]
        return cls(area=of_cells[:, 0], middle=of_cells[:, 1:3], squares=of_cells[:, xx_xy_xy_yy].reshape(-1, 2, 2),
                   gradient=of_cells[:, 6:10].reshape(-1, 2, 2),
                   moments=np.moveaxis(of_cells[:, 10:].reshape(-1, 2, 2, 2), 1, 3),
                   triangle_area=of_triangles[:, 0], triangle_gradient=of_triangles[:, 1:5].reshape(-1, 2, 2),
                   triangle_curving=of_triangles[:, 5:].reshape(-1, 2, 3))


def sum_around_nodes(mesh: Mesh, u: Array) -> Array:
    """Sum over the cells around each node.

    Parameters
    ----------
    mesh : Mesh
        Of plane cells, whose corners are their nodes.
    u : (n_dofs,) array
        Displacement, pixels.

    Returns
    -------
    (n_nodes, N_OF_CELLS + N_OF_TRIANGLES) array
        Which add up over meshes; ``SumsAroundNodes`` names them.
    """
    gradients = compute_displacement_gradients(mesh, u).reshape(-1, 4)
    areas, shares = measure_covered_areas(mesh)
    sums = np.zeros((mesh.n_nodes, N_OF_CELLS + N_OF_TRIANGLES))
    step = max(CELLS_AT_A_TIME, -(-mesh.n_cells // MOST_STEPS))
    for begin in range(0, mesh.n_cells, step):
        corners = list_corners(mesh, begin, min(begin + step, mesh.n_cells))
        of_corners = [_weigh_cells(mesh, corners, gradients) * areas[corners.cells, None],
                      _weigh_triangles(mesh, corners, u.reshape(-1, 2)) * shares[corners.cells, None]]
        for k, column in enumerate(np.column_stack(of_corners).T):
            sums[:, k] += np.bincount(corners.nodes, column, mesh.n_nodes)
    return sums


def _weigh_cells(mesh: Mesh, corners: Corners, gradients: Array) -> Array:
    """1, x, x x^T, G, G x of the cell of each corner, (n, 18)."""
    gradient = gradients[corners.cells]
    x = mesh.centroids[corners.cells] - mesh.nodes[corners.nodes]
    return np.column_stack([np.ones(len(x)), x, x[:, 0]**2, x[:, 0] * x[:, 1], x[:, 1]**2, gradient,
                            gradient * x[:, :1], gradient * x[:, 1:]])


def _weigh_triangles(mesh: Mesh, corners: Corners, moves: Array) -> Array:
    """Area of each corner's triangle, and times it the gradient there and what curvature adds, (n, 11)."""
    one, other = (mesh.nodes[n] - mesh.nodes[corners.nodes] for n in (corners.ahead, corners.behind))
    to_one, to_other = (moves[n] - moves[corners.nodes] for n in (corners.ahead, corners.behind))
    # Area times E^-T of E = [one, other] has no division: a flat corner weighs nothing.
    from_one = 0.5 * np.column_stack([other[:, 1], -other[:, 0]])
    from_other = 0.5 * np.column_stack([-one[:, 1], one[:, 0]])
    slopes = to_one[:, :, None] * from_one[:, None, :] + to_other[:, :, None] * from_other[:, None, :]
    curving = _bend(one)[:, None, :] * from_one[:, :, None] + _bend(other)[:, None, :] * from_other[:, :, None]
    return np.column_stack([0.5 * multiply_across(one, other), slopes.reshape(-1, 4), curving.reshape(-1, 6)])


def _bend(edge: Array) -> Array:
    """What curvature (xx, xy, yy) of a displacement adds to it at an edge's end, (n, 3)."""
    return np.column_stack([0.5 * edge[:, 0]**2, edge[:, 0] * edge[:, 1], 0.5 * edge[:, 1]**2])
