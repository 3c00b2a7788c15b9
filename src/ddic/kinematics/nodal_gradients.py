"""Displacement gradients at nodes, recovered from the cells around each of them.

The mean of the gradients of the triangles that a node makes with its neighbours along edges, weighted by their areas,
is the gradient at the node where the displacement is linear. Curvature adds to it where the triangles do not lie evenly
about the node; it is taken away by the slopes of the gradients in the middle of the cells, which are found by least
squares as in superconvergent patch recovery (Zienkiewicz and Zhu, IJNME 33, 1992). At edges of the mesh and along
discontinuities, where cells lie to one side, neighbours tell the slopes, and gradients are averaged along the edge. No
cell across a discontinuity is asked: its nodes are others. All comes of sums over the cells around each node.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from ddic.arrays import Array, BoolArray, IntArray
from ddic.kinematics.strain import compute_displacement_gradients
from ddic.mesh.mesh import Mesh, invert_matrices
from ddic.mesh.quality import measure_covered_areas

N_OF_CELLS, N_OF_TRIANGLES = 18, 11
"""Columns of what is summed over cells, and over the triangles at their corners."""


def _sum_around_nodes(mesh: Mesh, u: Array) -> Array:
    """Sum over the cells around each node, (n_nodes, N_OF_CELLS + N_OF_TRIANGLES).

    They add up over meshes. Cells are plane, their corners their nodes; ``u``, (n_dofs,), is nan where no cell uses it.
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


SumShared = Callable[[Sequence[Array]], list[Array]]
"""Sums at the nodes of some meshes, (n_nodes, k) each, over all meshes that have a node, at the same places."""

LARGEST_LEVERAGE = 0.9
"""Distance of a node from the middle of its cells, squared and relative to their spread, above which its own cells do
not determine it. A larger value trusts extrapolation from fewer cells: 0 in the middle of a grid, 0.5 at a corner that
reaches into the mesh, infinity at an edge with one row of cells."""

FLAT = 1e-6
"""Spread of cells across, relative to that along, below which they lie on a line: rounding."""

N_PASSES = 2
"""How many cells away from a node that its own cells determine other nodes are reached; a larger value extrapolates
farther. What is not reached, as in strips one cell wide, keeps the mean of its triangles."""


def recover_gradients(meshes: Sequence[Mesh], displacements: Sequence[Array], sum_shared: SumShared) -> list[Array]:
    """Recover the displacement gradient at all nodes; collective where ``sum_shared`` is.

    du_c / dx_j, (n_nodes, 2, 2) for each mesh, no unit; one value a node, whatever meshes have it. Cells are plane, and
    their corners are their nodes. Displacements are (n_dofs,), pixels, nan where not measured: cells with a node that
    was not measured are as good as not there; nan at nodes of such cells alone.
    """
    meshes = [_without_unmeasured_cells(mesh, u) for mesh, u in zip(meshes, displacements, strict=True)]
    around = sum_shared([_sum_around_nodes(mesh, u) for mesh, u in zip(meshes, displacements, strict=True)])
    slopes = own_slopes = [_fit_slopes(of_mesh[:, :N_OF_CELLS]) for of_mesh in around]
    for _ in range(N_PASSES):
        carried = sum_shared([_carry_slopes(mesh, known) for mesh, known in zip(meshes, slopes, strict=True)])
        slopes = [_take(known, to_nodes) for known, to_nodes in zip(slopes, carried, strict=True)]
    # Nodes with slopes that are not their own cells' lie at edges.
    found = [_AtNodes(_average_triangles(of_mesh[:, N_OF_CELLS:], of_nodes.value), of_nodes.value,
                      of_nodes.known & ~own.known)
             for of_mesh, of_nodes, own in zip(around, slopes, own_slopes, strict=True)]
    carried = sum_shared([_sum_along_edges(mesh, at_nodes) for mesh, at_nodes in zip(meshes, found, strict=True)])
    return [_average_along_edges(at_nodes, along) for at_nodes, along in zip(found, carried, strict=True)]


def _without_unmeasured_cells(mesh: Mesh, u: Array) -> Mesh:
    """All nodes, and the cells whose nodes all have a displacement."""
    is_measured = np.isfinite(u.reshape(mesh.nodes.shape)).all(axis=1)
    if is_measured.all():
        return mesh
    return mesh.keep_cells(mesh.find_cells_among(is_measured))


@dataclass(frozen=True, eq=False)
class _Slopes:
    """Derivatives by x_k of du_c / dx_j at nodes, 1/px: value (n_nodes, 2, 2, 2), zero where they are not known."""

    value: Array
    known: BoolArray


@dataclass(frozen=True, eq=False)
class _AtNodes:
    """Gradients at nodes (n_nodes, 2, 2), their slopes, and which nodes lie at an edge that is averaged along."""

    gradient: Array
    slope: Array
    at_edge: BoolArray


def _fit_slopes(sums: Array) -> _Slopes:
    """Slopes from the gradients in the middle of the nodes' own cells, by least squares; sums: as _add_cells orders."""
    # Nodes without a measured cell have no sums.
    means = sums / np.where(sums[:, 0] > 0, sums[:, 0], 1.0)[:, None]
    xx_xy_xy_yy = [3, 4, 4, 5]
    mean_x, mean_square = means[:, 1:3], means[:, xx_xy_xy_yy].reshape(-1, 2, 2)
    mean_gradient = means[:, 6:10].reshape(-1, 2, 2)
    mean_moment = np.moveaxis(means[:, 10:].reshape(-1, 2, 2, 2), 1, 3)
    spread = mean_square - mean_x[:, :, None] * mean_x[:, None, :]
    covariance = mean_moment - mean_gradient[..., None] * mean_x[:, None, None, :]
    widths = np.linalg.eigvalsh(spread)
    known = widths[:, 0] > FLAT * widths[:, 1]
    inverse = np.zeros_like(spread)
    inverse[known], _ = invert_matrices(spread[known])
    leverage = np.einsum("ni,nij,nj->n", mean_x, inverse, mean_x)
    known &= leverage <= LARGEST_LEVERAGE
    slope = np.einsum("ncjk,nkl->ncjl", covariance, inverse)
    slope[~known] = 0.0
    return _Slopes(slope, known)


def _average_triangles(sums: Array, slope: Array) -> Array:
    """Mean gradient, (n, 2, 2), of the triangles at nodes, without what curvature adds, from _add_triangles' sums."""
    means = sums / np.where(sums[:, 0] > 0, sums[:, 0], np.nan)[:, None]
    mean_gradient, mean_curving = means[:, 1:5].reshape(-1, 2, 2), means[:, 5:].reshape(-1, 2, 3)
    # u_c curves by the symmetric part: measured slopes need not be derivatives of one field.
    curvature = np.stack([slope[..., 0, 0], 0.5 * (slope[..., 0, 1] + slope[..., 1, 0]), slope[..., 1, 1]], axis=2)
    return np.asarray(mean_gradient - np.einsum("njm,ncm->ncj", mean_curving, curvature))


def _carry_slopes(mesh: Mesh, slopes: _Slopes) -> Array:
    """Sums for nodes without slopes over those of the same cells that have them, (n_nodes, 9): 1, slope; by area."""
    pairs = _pair_nodes(mesh, ~slopes.known, slopes.known)
    return _sum_pairs(mesh, pairs, slopes.value[pairs.source].reshape(-1, 8))


def _take(slopes: _Slopes, carried: Array) -> _Slopes:
    """Slopes with the mean of those that were carried to nodes that had none."""
    reached = ~slopes.known & (carried[:, 0] > 0)
    value = slopes.value.copy()
    value[reached] = (carried[reached, 1:] / carried[reached, :1]).reshape(-1, 2, 2, 2)
    return _Slopes(value, slopes.known | reached)


def _sum_along_edges(mesh: Mesh, found: _AtNodes) -> Array:
    """Sums for nodes at edges over those of the same cells, themselves too, (n_nodes, 5): 1, gradient; by area."""
    pairs = _pair_nodes(mesh, found.at_edge, found.at_edge)
    way = mesh.nodes[pairs.target] - mesh.nodes[pairs.source]
    # By the trapezoidal rule from node to node, whose error is of third order.
    mean_slope = 0.5 * (found.slope[pairs.source] + found.slope[pairs.target])
    values = found.gradient[pairs.source] + np.einsum("ncjk,nk->ncj", mean_slope, way)
    return _sum_pairs(mesh, pairs, values.reshape(-1, 4))


def _average_along_edges(found: _AtNodes, carried: Array) -> Array:
    """Gradients, at edges the mean along them: differences to one side have more noise than those of cells."""
    gradient = found.gradient.copy()
    gradient[found.at_edge] = (carried[found.at_edge, 1:] / carried[found.at_edge, :1]).reshape(-1, 2, 2)
    return gradient


class _Pairs(NamedTuple):
    """Pairs of nodes of one cell: the cell of each, the node that takes and the one that gives, (n,) each."""

    cells: IntArray
    target: IntArray
    source: IntArray


def _pair_nodes(mesh: Mesh, takes: BoolArray, gives: BoolArray) -> _Pairs:
    """All pairs of a node that takes and one that gives; takes, gives: (n_nodes,)."""
    # Few take, as a rule: those at edges.
    at_takers = np.flatnonzero(((mesh.cells >= 0) & takes[mesh.cells]).any(axis=1))
    cells = mesh.cells[at_takers]
    taking, giving = ((cells >= 0) & chosen[cells] for chosen in (takes, gives))
    there, here, number = np.nonzero(taking.T[:, None] & giving.T[None])
    return _Pairs(at_takers[number], cells[number, there], cells[number, here])


def _sum_pairs(mesh: Mesh, pairs: _Pairs, values: Array) -> Array:
    """Sums of 1 and of values (n_pairs, k) at the nodes that take, by the areas of cells, (n_nodes, 1 + k)."""
    if not len(pairs.cells):
        return np.zeros((mesh.n_nodes, 1 + values.shape[1]))
    areas, _ = measure_covered_areas(mesh)
    weights = areas[pairs.cells, None]
    weighted = np.column_stack([weights, values * weights])
    return np.column_stack([np.bincount(pairs.target, column, mesh.n_nodes) for column in weighted.T])
