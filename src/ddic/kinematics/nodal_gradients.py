"""Displacement gradients at nodes, recovered from the cells around each of them.

The mean of the gradients of the triangles that a node makes with its neighbours along edges, weighted by their areas,
is the gradient at the node where the displacement is linear. Curvature adds to it where the triangles do not lie evenly
about the node; it is taken away by the slopes of the gradients in the middle of the cells, which are found by least
squares as in superconvergent patch recovery (Zienkiewicz and Zhu, IJNME 33, 1992). At edges of the mesh and along
discontinuities, where cells lie to one side, neighbours tell the slopes, and gradients are averaged along the edge. No
cell across a discontinuity is asked: its nodes are others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ddic.kinematics.strain import compute_displacement_gradients
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import multiply_across

Array = NDArray[np.float64]
SumShared = Callable[[Sequence[Array]], list[Array]]
"""Sums at the nodes of some meshes, (n_nodes, k) each, over all meshes that have a node, at the same places."""

LARGEST_LEVERAGE = 0.9
"""Distance of a node from the middle of its cells, squared and relative to their spread, above which its own cells do
not determine it. A larger value trusts extrapolation from fewer cells: 0 in the middle of a grid, 0.5 at a corner that
reaches into the mesh, infinity at an edge with one row of cells."""

FLAT = 1e-6
"""Spread of cells across, relative to that along, below which they lie on a line: rounding."""

CELLS_AT_A_TIME, MOST_STEPS = 1 << 15, 32
"""Cells whose sums are made together (some 30 MB), and into how many parts a mesh is divided for that; larger values
take memory, or time."""

N_PASSES = 2
"""How many cells away from a node that its own cells determine other nodes are reached; a larger value extrapolates
farther. What is not reached, as in strips one cell wide, keeps the mean of its triangles."""


def recover_gradients(meshes: Sequence[Mesh], displacements: Sequence[Array], sum_shared: SumShared) -> list[Array]:
    """Recover the displacement gradient at all nodes; collective where ``sum_shared`` is.

    Parameters
    ----------
    meshes : sequence of Mesh
        Of plane cells, whose corners are their nodes.
    displacements : sequence of (n_dofs,) array
        Of their nodes, pixels; nan where it was not measured.
    sum_shared : callable
        Sums at nodes that several meshes have.

    Returns
    -------
    list of (n_nodes, 2, 2) array
        du_c / dx_j at the nodes of each mesh, no unit; one value a node, whatever meshes have it. Cells with a node
        that was not measured are as good as not there; nan at nodes of such cells alone.
    """
    meshes = [_without_unmeasured_cells(mesh, u) for mesh, u in zip(meshes, displacements, strict=True)]
    sums = sum_shared([_sum_cells(mesh, u) for mesh, u in zip(meshes, displacements, strict=True)])
    slopes = [_fit_slopes(of_mesh) for of_mesh in sums]
    inside = [at_nodes.known for at_nodes in slopes]
    for _ in range(N_PASSES):
        carried = sum_shared([_carry_slopes(mesh, known) for mesh, known in zip(meshes, slopes, strict=True)])
        slopes = [_take(known, to_nodes) for known, to_nodes in zip(slopes, carried, strict=True)]
    found = [_AtNodes(_average_triangles(of_mesh, of_nodes.value), of_nodes.value, of_nodes.known & ~is_inside)
             for of_mesh, of_nodes, is_inside in zip(sums, slopes, inside, strict=True)]
    carried = sum_shared([_sum_along_edges(mesh, at_nodes) for mesh, at_nodes in zip(meshes, found, strict=True)])
    return [_average_along_edges(at_nodes, along) for at_nodes, along in zip(found, carried, strict=True)]


def _without_unmeasured_cells(mesh: Mesh, u: Array) -> Mesh:
    """All nodes, and the cells whose nodes all have a displacement."""
    is_measured = np.isfinite(u.reshape(mesh.nodes.shape)).all(axis=1)
    if is_measured.all():
        return mesh
    part, node_ids = mesh.create_submesh(mesh.find_cells_among(is_measured))
    return replace(part, nodes=mesh.nodes, connectivity=node_ids[part.connectivity], node_sets=mesh.node_sets)


@dataclass(frozen=True, eq=False)
class _Slopes:
    """Derivatives by x_k of du_c / dx_j at nodes, 1/px: value (n_nodes, 2, 2, 2), zero where they are not known."""

    value: Array
    known: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class _AtNodes:
    """Gradients at nodes (n_nodes, 2, 2), their slopes, and which nodes lie at an edge that is averaged along."""

    gradient: Array
    slope: Array
    at_edge: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class _Corners:
    """Corners of some cells, one after the other: cell and node of each, the nodes ahead and behind, (n,) each."""

    cells: NDArray[np.int64]
    nodes: NDArray[np.int64]
    ahead: NDArray[np.int64]
    behind: NDArray[np.int64]


def _list_corners(mesh: Mesh, begin: int, end: int) -> _Corners:
    """The corners of cells begin to end, with the node after and before each in its cell."""
    first, last = mesh.offsets[begin], mesh.offsets[end]
    cells = np.repeat(np.arange(begin, end), np.diff(mesh.offsets[begin:end + 1]))
    counts = np.diff(mesh.offsets)[cells]
    place = np.arange(first, last) - mesh.offsets[cells]
    ahead = mesh.offsets[cells] + (place + 1) % counts
    behind = mesh.offsets[cells] + (place - 1) % counts
    return _Corners(cells, mesh.connectivity[first:last], mesh.connectivity[ahead], mesh.connectivity[behind])


def _measure_parts(mesh: Mesh) -> tuple[Array, Array]:
    """Area of what each cell covers, square pixels, and its share of the whole cell, (n_cells,)."""
    outlines = mesh.outlines
    areas = _measure_polygons(outlines.corners, outlines.connectivity, outlines.offsets)
    if mesh.parts is None:
        return areas, np.ones(mesh.n_cells)
    return areas, areas / _measure_polygons(mesh.nodes, mesh.connectivity, mesh.offsets)


def _measure_polygons(points: Array, connectivity: NDArray[np.int64], offsets: NDArray[np.int64]) -> Array:
    """Areas of polygons, (n,), square pixels."""
    counts = np.diff(offsets)
    first = np.repeat(offsets[:-1], counts)
    place = np.arange(len(connectivity)) - first
    ahead = first + (place + 1) % np.repeat(counts, counts)
    # Relative to the first corner, so that far from the origin no digits are lost.
    corners = points[connectivity] - points[connectivity[first]]
    return np.asarray(0.5 * np.add.reduceat(multiply_across(corners, corners[ahead]), offsets[:-1]))


def _sum_cells(mesh: Mesh, u: Array) -> Array:
    """Sums over the cells around each node, (n_nodes, 29).

    By the cells' areas: 1, x, x x^T, G, G x with x from the node to the cell's middle and G the gradient there. By the
    areas of corners' triangles: 1, their gradients, and what curvature (xx, xy, yy) of u adds to these.
    """
    gradients = compute_displacement_gradients(mesh, u).reshape(-1, 4)
    areas, shares = _measure_parts(mesh)
    sums = np.zeros((mesh.n_nodes, 29))
    step = max(CELLS_AT_A_TIME, -(-mesh.n_cells // MOST_STEPS))
    for begin in range(0, mesh.n_cells, step):
        corners = _list_corners(mesh, begin, min(begin + step, mesh.n_cells))
        of_corners = [_weigh_cells(mesh, corners, gradients) * areas[corners.cells, None],
                      _weigh_triangles(mesh, corners, u.reshape(-1, 2)) * shares[corners.cells, None]]
        for k, column in enumerate(np.column_stack(of_corners).T):
            sums[:, k] += np.bincount(corners.nodes, column, mesh.n_nodes)
    return sums


def _weigh_cells(mesh: Mesh, corners: _Corners, gradients: Array) -> Array:
    """1, x, x x^T, G, G x of the cell of each corner, (n, 18)."""
    gradient = gradients[corners.cells]
    x = mesh.centroids[corners.cells] - mesh.nodes[corners.nodes]
    return np.column_stack([np.ones(len(x)), x, x[:, 0]**2, x[:, 0] * x[:, 1], x[:, 1]**2, gradient,
                            gradient * x[:, :1], gradient * x[:, 1:]])


def _weigh_triangles(mesh: Mesh, corners: _Corners, moves: Array) -> Array:
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


def _fit_slopes(sums: Array) -> _Slopes:
    """Slopes from the gradients in the middle of the nodes' own cells, by least squares."""
    # Nodes without a measured cell have no sums.
    weight = np.where(sums[:, 0] > 0, sums[:, 0], 1.0)
    middle, squares = sums[:, 1:3] / weight[:, None], sums[:, 3:6] / weight[:, None]
    mean = sums[:, 6:10].reshape(-1, 2, 2) / weight[:, None, None]
    moments = np.moveaxis(sums[:, 10:18].reshape(-1, 2, 2, 2), 1, 3) / weight[:, None, None, None]
    spread = squares[:, [0, 1, 1, 2]].reshape(-1, 2, 2) - middle[:, :, None] * middle[:, None, :]
    widths = np.linalg.eigvalsh(spread)
    known = widths[:, 0] > FLAT * widths[:, 1]
    inverse = np.zeros_like(spread)
    inverse[known] = np.linalg.inv(spread[known])
    known &= np.einsum("ni,nij,nj->n", middle, inverse, middle) <= LARGEST_LEVERAGE
    slope = np.einsum("ncjk,nkl->ncjl", moments - mean[..., None] * middle[:, None, None, :], inverse)
    slope[~known] = 0.0
    return _Slopes(slope, known)


def _average_triangles(sums: Array, slope: Array) -> Array:
    """Mean gradient of the triangles at each node without what the displacement's curvature adds to it, (n, 2, 2)."""
    area = sums[:, 18:19]
    of_triangles = sums[:, 18:] / np.where(area > 0, area, np.nan)
    # u_c curves by the symmetric part: measured slopes need not be derivatives of one field.
    curvature = np.stack([slope[..., 0, 0], 0.5 * (slope[..., 0, 1] + slope[..., 1, 0]), slope[..., 1, 1]], axis=2)
    added = np.einsum("njm,ncm->ncj", of_triangles[:, 5:].reshape(-1, 2, 3), curvature)
    return np.asarray(of_triangles[:, 1:5].reshape(-1, 2, 2) - added)


def _carry_slopes(mesh: Mesh, slopes: _Slopes) -> Array:
    """Sums for nodes without slopes over those of the same cells that have them, (n_nodes, 9): 1, slope; by area."""
    pairs = _pair_nodes(mesh, ~slopes.known, slopes.known)
    values = slopes.value[pairs.source].reshape(-1, 8)
    return _sum_pairs(mesh, pairs, values)


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


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Pairs of nodes of one cell: the cell of each, the node that takes and the one that gives, (n,) each."""

    cells: NDArray[np.int64]
    target: NDArray[np.int64]
    source: NDArray[np.int64]


def _pair_nodes(mesh: Mesh, takes: NDArray[np.bool_], gives: NDArray[np.bool_]) -> _Pairs:
    """All pairs of a node that takes and one that gives; takes, gives: (n_nodes,)."""
    none = np.zeros(0, dtype=np.int64)
    found = [(none, none, none)]
    for there, here in product(mesh.cells.T, repeat=2):
        cells = np.flatnonzero((there >= 0) & (here >= 0))
        cells = cells[takes[there[cells]] & gives[here[cells]]]
        found.append((cells, there[cells], here[cells]))
    return _Pairs(*(np.concatenate(arrays) for arrays in zip(*found, strict=True)))


def _sum_pairs(mesh: Mesh, pairs: _Pairs, values: Array) -> Array:
    """Sums of 1 and of values (n_pairs, k) at the nodes that take, by the areas of cells, (n_nodes, 1 + k)."""
    weights = _measure_parts(mesh)[0][pairs.cells, None]
    weighted = np.column_stack([weights, values * weights])
    return np.column_stack([np.bincount(pairs.target, column, mesh.n_nodes) for column in weighted.T])
