"""Kinematics with discontinuities: a node cut off by a line has a displacement on each side [RRH07]."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Literal

import numpy as np
from scipy import sparse

from ddic.arrays import Array, BoolArray, IntArray
from ddic.kinematics.kinematics import Kinematics
from ddic.kinematics.linear import LinearRegion
from ddic.kinematics.nodal import NodalKinematics, component_numbers
from ddic.mesh.cut_mesh import CutMesh
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import compute_normals, find_nearest_segments, measure_distance

Opening = Literal["both", "tangential", "normal"]
"""Directions, seen from the line, in which the displacement may be discontinuous."""


@dataclass(frozen=True, eq=False)
class Discontinuities:
    """Lines across which the displacement may be discontinuous.

    Attributes
    ----------
    lines : tuple of (n_vertices, 2) array
        Polylines, pixels.
    openings : tuple of Opening
        Of each line.
    """

    lines: tuple[Array, ...] = ()
    openings: tuple[Opening, ...] = ()

    def with_line(self, number: int, line: Array) -> Discontinuities:
        """Give the same lines but for one, which lies elsewhere: (n_vertices, 2), pixels."""
        return Discontinuities((*self.lines[:number], line, *self.lines[number + 1:]), self.openings)

    def scale(self, origin: float | Array, factor: float) -> Discontinuities:
        """Give the lines in coarser pixels, with a side of ``factor`` pixels.

        ``origin`` is the position of the first coarse pixel's centre along either axis, or along each, pixels.
        """
        return Discontinuities(tuple((line - origin) / factor for line in self.lines), self.openings)


LEAST_SHARE = 0.03
"""Share of the sum of N_a^2 over the pixels around a node that a side must have for a displacement of its own. With a
smaller one far corners decide, where noise is large and Gauss-Newton may diverge; a larger one ties more nodes to
their neighbours'."""

LEAST_WEIGHT = 0.1
"""Least weight with which a neighbour counts: each takes its subdomain into a node's unknowns."""

SAME_DISTANCE = 1e-6
"""Pixels by which neighbours may be farther than the nearest one and count as near as it."""


@dataclass(frozen=True, eq=False)
class EnrichedRegion(LinearRegion):
    """Unknowns that are displacements of nodes and, where a line cuts, how far the other side is beyond.

    Attributes
    ----------
    mesh : Mesh
        The cut mesh.
    matrix : (mesh.n_dofs, n_unknowns) csr_matrix
        T of u = T q; the identity but at nodes with phantoms.
    node_of_unknown : (n_unknowns,) array of int64
        Node at which an unknown stands.
    seen_at : (n_unknowns,) array of int64
        Node of the cut mesh whose pixels determine it.
    """

    node_of_unknown: IntArray
    seen_at: IntArray

    def controlled(self, nodes: BoolArray) -> BoolArray:
        """Tell which unknowns are controlled: those of controlled nodes. The faces of a line bear no forces."""
        return np.asarray(nodes[self.node_of_unknown])

    def restrict(self, part: Mesh, node_ids: IntArray, numbers: IntArray) -> Kinematics:
        """Give a subdomain its kinematics: nodal where no line is near."""
        if np.array_equal(numbers, component_numbers(node_ids, self.mesh.dim)):
            return NodalKinematics(part, numbers)
        return super().restrict(part, node_ids, numbers)


def enrich(cut: CutMesh, corner_weights: Array, openings: Sequence[Opening]) -> EnrichedRegion:
    """Give phantom nodes of a cut mesh displacements of their own, where they have pixels enough.

    Of a node and its phantoms, the one with most pixels leads. One with too few pixels follows it at the mean distance
    of its neighbours across the line. ``corner_weights`` say how firmly the pixels of each cell hold each of its nodes
    (``weigh_corners``), (len(cut.mesh.connectivity),); ``openings`` are one a line.
    """
    leader, is_active = _judge_twins(cut, corner_weights)
    dim, n_nodes = cut.mesh.dim, int(cut.node_of.max()) + 1
    leads = leader == np.arange(cut.mesh.n_nodes)
    free = np.flatnonzero(~leads & is_active)
    directions = _find_directions(cut, free, openings)
    n_directions = np.array([axes.shape[1] for axes in directions], dtype=np.int64)
    n_unknowns = n_nodes * dim + int(n_directions.sum())

    matrix = _move_with_nodes(cut, n_unknowns)
    matrix = matrix + _open_by_unknowns(cut, free, directions, n_unknowns)
    matrix = _follow_neighbours(cut, leader, leads | is_active, matrix)
    seen_at = np.concatenate([np.repeat(leader[:n_nodes], dim), np.repeat(free, n_directions)])
    return EnrichedRegion(cut.mesh, matrix, cut.node_of[seen_at], seen_at)


def _judge_twins(cut: CutMesh, corner_weights: Array) -> tuple[IntArray, BoolArray]:
    """Of each node and its phantoms find which one leads, with most pixels, and of each whether it has enough."""
    mesh = cut.mesh
    of_each = np.bincount(mesh.connectivity, weights=corner_weights, minlength=mesh.n_nodes)
    of_place = np.bincount(cut.node_of, weights=of_each)
    # The last one at a place wins, which is the one with most pixels.
    order = np.argsort(of_each, kind="stable")
    largest = np.zeros(len(of_place), dtype=np.int64)
    largest[cut.node_of[order]] = order
    return largest[cut.node_of], of_each >= LEAST_SHARE * of_place[cut.node_of]


def _move_with_nodes(cut: CutMesh, n_unknowns: int) -> sparse.csr_matrix:
    """Rows by which all at one place move together."""
    n_dofs = cut.mesh.n_dofs
    columns = component_numbers(cut.node_of, cut.mesh.dim)
    return sparse.csr_matrix((np.ones(n_dofs), (np.arange(n_dofs), columns)), shape=(n_dofs, n_unknowns))


def _open_by_unknowns(cut: CutMesh, free: IntArray, directions: Sequence[Array], n_unknowns: int) -> sparse.csr_matrix:
    """Rows by which nodes move beyond those that lead, along directions (dim, n_directions) of each."""
    dim = cut.mesh.dim
    shape = (cut.mesh.n_dofs, n_unknowns)
    matrix = sparse.lil_matrix(shape)
    column = (int(cut.node_of.max()) + 1) * dim
    for node, axes in zip(free.tolist(), directions, strict=True):
        n_directions = axes.shape[1]
        matrix[node * dim:(node + 1) * dim, column:column + n_directions] = axes
        column += n_directions
    return matrix.tocsr()


def _find_directions(cut: CutMesh, nodes: IntArray, openings: Sequence[Opening]) -> list[Array]:
    """Unit vectors along which each node may move beyond the one that leads, (dim, n_directions)."""
    points = cut.mesh.nodes[nodes]
    tangents, lines = _find_tangents(cut, points)
    return [_directions_of(openings[line], tangent) for line, tangent in zip(lines, tangents, strict=True)]


def _find_tangents(cut: CutMesh, points: Array) -> tuple[Array, IntArray]:
    """Unit vector along the nearest segment of any line, (n, dim), and the number of that line."""
    nearest = np.array([measure_distance(points, line) for line in cut.lines]).argmin(axis=0)
    tangents = np.empty(points.shape)
    for number, line in enumerate(cut.lines):
        mine = np.flatnonzero(nearest == number)
        along = np.diff(line, axis=0)[find_nearest_segments(points[mine], line)[0]]
        tangents[mine] = along / np.linalg.norm(along, axis=1)[:, None]
    return tangents, nearest


def _directions_of(opening: Opening, tangent: Array) -> Array:
    if opening == "both":
        return np.eye(len(tangent))
    return tangent[:, None] if opening == "tangential" else compute_normals(tangent)[:, None]


def _follow_neighbours(cut: CutMesh, leader: IntArray, is_free: BoolArray,
                       matrix: sparse.csr_matrix) -> sparse.csr_matrix:
    """Rows by which bound nodes open as their neighbours do, free ones first; one that none reaches stays closed."""
    is_known = is_free.copy()
    while pairs := _find_pairs_across(cut, leader, is_known):
        matrix = matrix + _average_openings(cut, pairs) @ matrix
        is_known[list(pairs)] = True
    return matrix


def _average_openings(cut: CutMesh, pairs_of: Mapping[int, Sequence[tuple[int, int]]]) -> sparse.csr_matrix:
    """Distances across the line that bound nodes take from their neighbours, (n_dofs, n_dofs); nothing for others."""
    n, dim = cut.mesh.n_nodes, cut.mesh.dim
    mean = sparse.lil_matrix((n, n))
    for node, pairs in pairs_of.items():
        neighbours = cut.mesh.nodes[[this_side for this_side, _ in pairs]]
        (tangent,), _ = _find_tangents(cut, cut.mesh.nodes[[node]])
        shares = _interpolate_along((neighbours - cut.mesh.nodes[node]) @ tangent)
        for k in np.flatnonzero(shares):
            mean[node, pairs[k][0]] += shares[k]
            mean[node, pairs[k][1]] -= shares[k]
    return sparse.kron(mean.tocsr(), sparse.identity(dim), format="csr")


def _interpolate_along(places: Array) -> Array:
    """Weights of values at places along a line for the value at 0, linear between the nearest on either side.

    Where all lie on one side, the nearest's value: more noise would come from going on linearly.
    """
    ahead, behind = places[places >= 0], places[places <= 0]
    if not len(ahead) or not len(behind):
        nearest = np.abs(places) <= np.abs(places).min() + SAME_DISTANCE
        return np.asarray(nearest / nearest.sum())
    next_one, last_one = float(ahead.min()), float(behind.max())
    at_next, at_last = np.abs(places - next_one) <= SAME_DISTANCE, np.abs(places - last_one) <= SAME_DISTANCE
    share = -last_one / (next_one - last_one) if next_one - last_one > SAME_DISTANCE else 0.5
    share = 0.0 if share < LEAST_WEIGHT else 1.0 if share > 1 - LEAST_WEIGHT else share
    return np.asarray(share * at_next / at_next.sum() + (1 - share) * at_last / at_last.sum())


def _find_pairs_across(cut: CutMesh, leader: IntArray, is_known: BoolArray) -> dict[int, list[tuple[int, int]]]:
    """Known neighbours of unknown nodes, on their own side, and their twins on the side of the one that leads these."""
    if is_known.all():
        return {}
    found: dict[int, list[tuple[int, int]]] = {}
    for parts in _group_parts(cut):
        for one, other in permutations(parts, 2):
            are_known = (one != other) & is_known[one] & is_known[other]
            pairs = list(zip(one[are_known].tolist(), other[are_known].tolist(), strict=True))
            for node, across in zip(one.tolist(), other.tolist(), strict=True):
                if pairs and not is_known[node] and across == leader[node]:
                    known = found.setdefault(node, [])
                    known += [pair for pair in pairs if pair not in known]
    return found


def _group_parts(cut: CutMesh) -> list[list[IntArray]]:
    """Nodes of the parts of each cut cell."""
    groups: dict[int, list[IntArray]] = {}
    cells = np.zeros(0, np.int64) if cut.mesh.parts is None else cut.mesh.parts.cells
    for number in cells:
        groups.setdefault(int(cut.cell_of[number]), []).append(cut.mesh.get_cell(number))
    return list(groups.values())
