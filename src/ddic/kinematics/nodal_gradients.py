"""Displacement gradients at nodes, recovered from the cells around each of them.

The mean of the gradients of the triangles, or tetrahedra, that a node makes with its neighbours along edges, weighted
by their sizes, is the gradient at the node where the displacement is linear. Curvature adds to it where they do not
lie evenly about the node; it is taken away by the slopes of the gradients in the middle of the cells, which are found
by least squares as in superconvergent patch recovery (Zienkiewicz and Zhu, IJNME 33, 1992). At edges of the mesh and
along discontinuities, where cells lie to one side, neighbours tell the slopes, and gradients are averaged along the
edge. No cell across a discontinuity is asked: its nodes are others. All comes of sums over the cells around each node.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import NamedTuple

import numba
import numpy as np

from ddic.arrays import Array, BoolArray, IntArray
from ddic.kinematics.strain import compute_displacement_gradients
from ddic.mesh.mesh import Mesh, invert_matrices
from ddic.mesh.quality import list_corners, measure_covered_areas


def _count_pairs(dim: int) -> int:
    """Products of two coordinates, each pair once: xx, xy, yy, or xx, xy, xz, yy, yz, zz."""
    return dim * (dim + 1) // 2


def _count_columns(dim: int) -> int:
    """Columns of what is summed over cells: 1, x, x x^T, G and G x; what is summed at their corners follows them."""
    return 1 + dim + _count_pairs(dim) + dim**2 * (1 + dim)


def _sum_around_nodes(mesh: Mesh, u: Array) -> Array:
    """Sum over the cells around each node, (n_nodes, columns of cells and of their corners).

    They add up over meshes. Corners of cells are their nodes; ``u``, (n_dofs,), is nan where no cell uses it.
    """
    dim = mesh.dim
    gradients = compute_displacement_gradients(mesh, u).reshape(-1, dim**2)
    sizes, shares = measure_covered_areas(mesh)
    n_columns = _count_columns(dim)
    sums = np.zeros((mesh.n_nodes, n_columns + 1 + dim**2 + dim * _count_pairs(dim)))
    corners = list_corners(mesh)
    _add_cells(corners.cells, corners.nodes, mesh.nodes, mesh.centroids, sizes, gradients, sums[:, :n_columns])
    _add_simplices(corners.cells, corners.nodes, corners.ends, mesh.nodes, shares, u.reshape(-1, dim),
                   sums[:, n_columns:])
    return sums


@numba.njit(cache=True)
def _add_cells(cells, corners, nodes, centroids, sizes, gradients, sums):  # type: ignore[no-untyped-def]
    """Add 1, x, x x^T, G, G x of each cell, times its size, at its corners."""
    dim = nodes.shape[1]
    n_gradients = dim * dim
    x = np.empty(dim)
    for k in range(len(corners)):
        e, n = cells[k], corners[k]
        size = sizes[e]
        sums[n, 0] += size
        column = 1
        for i in range(dim):
            x[i] = centroids[e, i] - nodes[n, i]
            sums[n, column] += size * x[i]
            column += 1
        for i in range(dim):
            for j in range(i, dim):
                sums[n, column] += size * x[i] * x[j]
                column += 1
        for c in range(n_gradients):
            gradient = size * gradients[e, c]
            sums[n, column + c] += gradient
            for i in range(dim):
                sums[n, column + (1 + i) * n_gradients + c] += gradient * x[i]


@numba.njit(cache=True)
def _find_cofactors(edges, factor, cofactors):  # type: ignore[no-untyped-def]
    """The determinant of edges, (dim, dim), times a factor, and their cofactors times it: det times edges^-T."""
    if len(edges) == 2:
        cofactors[0, 0], cofactors[0, 1] = factor * edges[1, 1], -factor * edges[1, 0]
        cofactors[1, 0], cofactors[1, 1] = -factor * edges[0, 1], factor * edges[0, 0]
    else:
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            for i in range(3):
                j, k = (i + 1) % 3, (i + 2) % 3
                cofactors[a, i] = factor * (edges[b, j] * edges[c, k] - edges[b, k] * edges[c, j])
    return (edges[0] * cofactors[0]).sum()


@numba.njit(cache=True)
def _add_simplices(cells, corners, ends, nodes, shares, moves, sums):  # type: ignore[no-untyped-def]
    """Add size, gradient and what curvature adds to it, of the triangle or tetrahedron at each corner."""
    dim = nodes.shape[1]
    n_pairs = dim * (dim + 1) // 2
    edges, cofactors = np.empty((dim, dim)), np.empty((dim, dim))
    for k in range(len(corners)):
        n = corners[k]
        for a in range(dim):
            for i in range(dim):
                edges[a, i] = nodes[ends[k, a], i] - nodes[n, i]
        # Size times E^-T of the edges E has no division: a flat corner weighs nothing.
        sums[n, 0] += _find_cofactors(edges, shares[cells[k]] / (2.0 if dim == 2 else 6.0), cofactors)
        for a in range(dim):
            for c in range(dim):
                to_end = moves[ends[k, a], c] - moves[n, c]
                for j in range(dim):
                    sums[n, 1 + dim * c + j] += to_end * cofactors[a, j]
            # What curvatures xx, xy, ... of a displacement add to it at the edge's end.
            pair = 1 + dim * dim
            for i in range(dim):
                for j in range(i, dim):
                    bend = edges[a, i] * edges[a, j] * (0.5 if i == j else 1.0)
                    for c in range(dim):
                        sums[n, pair + n_pairs * c] += bend * cofactors[a, c]
                    pair += 1


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

    du_c / dx_j, (n_nodes, dim, dim) for each mesh, no unit; one value a node, whatever meshes have it. The cells'
    corners are their nodes. Displacements are (n_dofs,), pixels, nan where not measured: cells with a node that
    was not measured are as good as not there; nan at nodes of such cells alone.
    """
    meshes = [_without_unmeasured_cells(mesh, u) for mesh, u in zip(meshes, displacements, strict=True)]
    dims = {mesh.dim for mesh in meshes}
    dim = dims.pop() if dims else 2
    n_columns = _count_columns(dim)
    around = sum_shared([_sum_around_nodes(mesh, u) for mesh, u in zip(meshes, displacements, strict=True)])
    slopes = own_slopes = [_fit_slopes(of_mesh[:, :n_columns], dim) for of_mesh in around]
    for _ in range(N_PASSES):
        carried = sum_shared([_carry_slopes(mesh, known) for mesh, known in zip(meshes, slopes, strict=True)])
        slopes = [_take(known, to_nodes) for known, to_nodes in zip(slopes, carried, strict=True)]
    # Nodes with slopes that are not their own cells' lie at edges.
    found = [_AtNodes(_average_simplices(of_mesh[:, n_columns:], of_nodes.value), of_nodes.value,
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
    """Derivatives by x_k of du_c / dx_j at nodes, 1/px: value (n_nodes, dim, dim, dim), zero where not known."""

    value: Array
    known: BoolArray


@dataclass(frozen=True, eq=False)
class _AtNodes:
    """Gradients at nodes (n_nodes, dim, dim), their slopes, and which nodes lie at an edge that is averaged along."""

    gradient: Array
    slope: Array
    at_edge: BoolArray


def _fit_slopes(sums: Array, dim: int) -> _Slopes:
    """Slopes from the gradients in the middle of the nodes' own cells, by least squares; sums: as _add_cells orders."""
    # Nodes without a measured cell have no sums.
    means = sums / np.where(sums[:, 0] > 0, sums[:, 0], 1.0)[:, None]
    _, mean_x, pairs, gradient, moment = np.split(means, np.cumsum([1, dim, _count_pairs(dim), dim**2]), axis=1)
    mean_square = np.empty((len(means), dim, dim))
    for values, (i, j) in zip(pairs.T, combinations_with_replacement(range(dim), 2), strict=True):
        mean_square[:, i, j] = mean_square[:, j, i] = values
    mean_gradient = gradient.reshape(-1, dim, dim)
    mean_moment = np.moveaxis(moment.reshape(-1, dim, dim, dim), 1, 3)
    spread = mean_square - mean_x[:, :, None] * mean_x[:, None, :]
    covariance = mean_moment - mean_gradient[..., None] * mean_x[:, None, None, :]
    widths = np.linalg.eigvalsh(spread)
    known = widths[:, 0] > FLAT * widths[:, -1]
    inverse = np.zeros_like(spread)
    inverse[known], _ = invert_matrices(spread[known])
    leverage = np.einsum("ni,nij,nj->n", mean_x, inverse, mean_x)
    known &= leverage <= LARGEST_LEVERAGE
    slope = np.einsum("ncjk,nkl->ncjl", covariance, inverse)
    slope[~known] = 0.0
    return _Slopes(slope, known)


def _average_simplices(sums: Array, slope: Array) -> Array:
    """Mean gradient, (n, dim, dim), of the simplices at nodes, without what curvature adds, from _add_simplices."""
    dim = slope.shape[1]
    means = sums / np.where(sums[:, 0] > 0, sums[:, 0], np.nan)[:, None]
    _, gradient, curving = np.split(means, [1, 1 + dim**2], axis=1)
    mean_gradient, mean_curving = gradient.reshape(-1, dim, dim), curving.reshape(-1, dim, _count_pairs(dim))
    # u_c curves by the symmetric part: measured slopes need not be derivatives of one field.
    curvature = np.stack([0.5 * (slope[..., i, j] + slope[..., j, i])
                          for i, j in combinations_with_replacement(range(dim), 2)], axis=2)
    return np.asarray(mean_gradient - np.einsum("njm,ncm->ncj", mean_curving, curvature))


def _carry_slopes(mesh: Mesh, slopes: _Slopes) -> Array:
    """Sums for nodes without slopes over those of their cells with them, (n_nodes, 1 + dim^3): 1, slope; by size."""
    pairs = _pair_nodes(mesh, ~slopes.known, slopes.known)
    return _sum_pairs(mesh, pairs, slopes.value[pairs.source].reshape(-1, mesh.dim**3))


def _take(slopes: _Slopes, carried: Array) -> _Slopes:
    """Slopes with the mean of those that were carried to nodes that had none."""
    reached = ~slopes.known & (carried[:, 0] > 0)
    value = slopes.value.copy()
    value[reached] = (carried[reached, 1:] / carried[reached, :1]).reshape(-1, *value.shape[1:])
    return _Slopes(value, slopes.known | reached)


def _sum_along_edges(mesh: Mesh, found: _AtNodes) -> Array:
    """Sums for nodes at edges over those of their cells, themselves too, (n_nodes, 1 + dim^2): 1, gradient; by size."""
    pairs = _pair_nodes(mesh, found.at_edge, found.at_edge)
    way = mesh.nodes[pairs.target] - mesh.nodes[pairs.source]
    # By the trapezoidal rule from node to node, whose error is of third order.
    mean_slope = 0.5 * (found.slope[pairs.source] + found.slope[pairs.target])
    values = found.gradient[pairs.source] + np.einsum("ncjk,nk->ncj", mean_slope, way)
    return _sum_pairs(mesh, pairs, values.reshape(-1, mesh.dim**2))


def _average_along_edges(found: _AtNodes, carried: Array) -> Array:
    """Gradients, at edges the mean along them: differences to one side have more noise than those of cells."""
    gradient = found.gradient.copy()
    gradient[found.at_edge] = (carried[found.at_edge, 1:] / carried[found.at_edge, :1]).reshape(-1, *gradient.shape[1:])
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
