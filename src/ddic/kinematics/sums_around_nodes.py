"""Sums over the cells around each node, from which the displacement gradient there is recovered."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from ddic.kinematics.strain import compute_displacement_gradients
from ddic.mesh.mesh import Mesh
from ddic.mesh.quality import measure_covered_areas

Array = NDArray[np.float64]

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
        # _add_cells and _add_triangles order them so.
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
        Displacement, pixels; where it is nan no cell uses it.

    Returns
    -------
    (n_nodes, N_OF_CELLS + N_OF_TRIANGLES) array
        Which add up over meshes; ``SumsAroundNodes`` names them.
    """
    gradients = compute_displacement_gradients(mesh, u).reshape(-1, 4)
    areas, shares = measure_covered_areas(mesh)
    sums = np.zeros((mesh.n_nodes, N_OF_CELLS + N_OF_TRIANGLES))
    cells = (mesh.connectivity, mesh.offsets, mesh.nodes)
    _add_cells(*cells, mesh.centroids, areas, gradients, sums[:, :N_OF_CELLS])
    _add_triangles(*cells, shares, u.reshape(-1, 2), sums[:, N_OF_CELLS:])
    return sums


@numba.njit(cache=True)
def _add_cells(connectivity, offsets, nodes, centroids, areas, gradients, sums):  # type: ignore[no-untyped-def]
    """Add 1, x, x x^T, G, G x of each cell, times its area, at its corners; sums: (n_nodes, 18)."""
    for e in range(len(areas)):
        area = areas[e]
        for n in connectivity[offsets[e]:offsets[e + 1]]:
            x = centroids[e, 0] - nodes[n, 0]
            y = centroids[e, 1] - nodes[n, 1]
            sums[n, 0] += area
            sums[n, 1] += area * x
            sums[n, 2] += area * y
            sums[n, 3] += area * x * x
            sums[n, 4] += area * x * y
            sums[n, 5] += area * y * y
            for k in range(4):
                gradient = area * gradients[e, k]
                sums[n, 6 + k] += gradient
                sums[n, 10 + k] += gradient * x
                sums[n, 14 + k] += gradient * y


@numba.njit(cache=True)
def _add_triangles(connectivity, offsets, nodes, shares, moves, sums):  # type: ignore[no-untyped-def]
    """Add area, gradient and what curvature adds to it, of the triangle at each corner; sums: (n_nodes, 11)."""
    for e in range(len(shares)):
        corners = connectivity[offsets[e]:offsets[e + 1]]
        for k in range(len(corners)):
            n = corners[k]
            ahead, behind = corners[(k + 1) % len(corners)], corners[k - 1]
            one_x, one_y = nodes[ahead, 0] - nodes[n, 0], nodes[ahead, 1] - nodes[n, 1]
            other_x, other_y = nodes[behind, 0] - nodes[n, 0], nodes[behind, 1] - nodes[n, 1]
            half = 0.5 * shares[e]
            sums[n, 0] += half * (one_x * other_y - one_y * other_x)
            # Area times E^-T of E = [one, other] has no division: a flat corner weighs nothing.
            from_one = (half * other_y, -half * other_x)
            from_other = (-half * one_y, half * one_x)
            # What curvatures xx, xy, yy of a displacement add to it at the edges' ends.
            bend_one = (0.5 * one_x * one_x, one_x * one_y, 0.5 * one_y * one_y)
            bend_other = (0.5 * other_x * other_x, other_x * other_y, 0.5 * other_y * other_y)
            for j in range(2):
                for c in range(2):
                    to_one, to_other = moves[ahead, c] - moves[n, c], moves[behind, c] - moves[n, c]
                    sums[n, 1 + 2 * c + j] += to_one * from_one[j] + to_other * from_other[j]
                for m in range(3):
                    sums[n, 5 + 3 * j + m] += bend_one[m] * from_one[j] + bend_other[m] * from_other[j]
