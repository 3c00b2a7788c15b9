"""Mortar between the edges of two meshes that touch along a line where their nodes need not meet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

NOTHING = 1e-14
"""Weight below which a master is none: rounding."""

STRAIGHT = 1e-6
"""Angle below which a line of edges does not bend, radians."""


@dataclass(frozen=True)
class Sides:
    """The two sides that may touch.

    far_nodes, near_nodes: (n, 2), pixels; far_edges, near_edges: (n, 2) straight edges, nodes of their ends.
    tolerance: distance below which points are one, pixels.
    """

    far_nodes: NDArray[np.float64]
    far_edges: NDArray[np.int64]
    near_nodes: NDArray[np.float64]
    near_edges: NDArray[np.int64]
    tolerance: float


@dataclass(frozen=True)
class Overlaps:
    """Pieces of a line that a far and a near edge have in common.

    far, near: (n,) edges; near_ends, far_ends: (n, 2) where a piece begins and ends on each, 0 to 1 along it.
    """

    far: NDArray[np.int64]
    near: NDArray[np.int64]
    near_ends: NDArray[np.float64]
    far_ends: NDArray[np.float64]

    def far_cover(self, n_edges: int) -> NDArray[np.float64]:
        """Share of each far edge that near edges cover, (n_edges,)."""
        return np.asarray(np.bincount(self.far, np.abs(np.diff(self.far_ends)[:, 0]), n_edges), dtype=np.float64)

    def near_cover(self, n_edges: int) -> NDArray[np.float64]:
        """Share of each near edge that far edges cover, (n_edges,)."""
        return np.asarray(np.bincount(self.near, np.diff(self.near_ends)[:, 0], n_edges), dtype=np.float64)


@dataclass(frozen=True)
class Mortar:
    """Displacements of near nodes on the common line (slaves) from those of far nodes (masters): u = P u_far.

    slaves: (n,) sorted near nodes; weights: P, (n, n_far_nodes).
    """

    slaves: NDArray[np.int64]
    weights: sparse.csr_matrix


def overlaps(sides: Sides) -> Overlaps:
    """Find where far edges run along near edges."""
    begin = sides.near_nodes[sides.near_edges[:, 0]]
    along = sides.near_nodes[sides.near_edges[:, 1]] - begin
    length = np.linalg.norm(along, axis=1)
    found = [_along_one(sides, k, begin, along, length) for k in range(len(sides.far_edges))]
    return Overlaps(*(np.concatenate([np.zeros_like(empty), *(piece[part] for piece in found)])
                      for part, empty in enumerate((np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)),
                                                    np.zeros((0, 2))))))


def mortar(sides: Sides, pieces: Overlaps) -> Mortar:
    """Integrate P with dual multipliers on the near edges, exactly; all pieces of an edge must cover it.

    int psi_i (u_near - u_far) = 0 with psi_1 = 2 N_1 - N_2, psi_2 = 2 N_2 - N_1 on each near edge, which makes
    int psi_i N_j diagonal (B. I. Wohlmuth, SIAM J. Numer. Anal. 38 (2000) 989-1012), so that every slave depends on
    the far edges beside it. Where the line ends or bends, the slave is the far node there and has no multiplier; on
    its edges the neighbours' are then 1. Constant and linear fields are kept, and P^T passes on what a constant stress
    makes of forces, whose direction changes with the line's.
    """
    edges = np.unique(pieces.near)
    slaves = np.unique(sides.near_edges[edges])
    at_corners = _corners(sides, edges, np.unique(sides.far_edges[pieces.far]))
    corners = np.flatnonzero(np.diff(at_corners.indptr))
    pinned = np.isin(sides.near_edges, corners)
    length = np.linalg.norm(np.diff(sides.near_nodes[sides.near_edges], axis=1)[:, 0], axis=1)
    shape = (len(sides.near_nodes), len(sides.far_nodes))
    to_far = sparse.csr_matrix(shape)
    for place in range(2):
        for other in range(2):
            values = _moments(pieces, place, other, pinned[pieces.near]) * length[pieces.near]
            rows, columns = sides.near_edges[pieces.near, place], sides.far_edges[pieces.far, other]
            to_far = to_far + sparse.csr_matrix((values, (rows, columns)), shape=shape)
    mass = np.bincount(sides.near_edges[edges].ravel(), np.repeat(length[edges] / 2, 2), len(sides.near_nodes))
    beside = _half_edges(sides, edges[pinned[edges].any(axis=1)], length)
    mass[corners] = np.inf
    inverse = sparse.diags(1.0 / np.where(mass > 0, mass, np.inf))
    weights = (inverse @ (to_far - beside @ at_corners) + at_corners).tocsr()[slaves]
    weights.data[np.abs(weights.data) < NOTHING] = 0.0
    weights.eliminate_zeros()
    return Mortar(slaves, weights)


def _along_one(sides: Sides, edge: int, begin: NDArray[np.float64], along: NDArray[np.float64],
               length: NDArray[np.float64]) -> tuple[NDArray[np.int64], ...]:
    """Pieces that one far edge has in common with near edges: (far, near, near_ends, far_ends)."""
    ends = sides.far_nodes[sides.far_edges[edge]]
    apart = ends[None] - begin[:, None]
    place = (apart * along[:, None]).sum(axis=2) / length[:, None] ** 2
    height = (apart[..., 1] * along[:, None, 0] - apart[..., 0] * along[:, None, 1]) / length[:, None]
    small = (sides.tolerance / length)[:, None]
    near_ends = np.clip(np.sort(place, axis=1), 0.0, 1.0)
    near_ends = np.where(near_ends < small, 0.0, np.where(near_ends > 1.0 - small, 1.0, near_ends))
    span = place[:, 1] - place[:, 0]
    candidates = np.flatnonzero((near_ends[:, 1] - near_ends[:, 0] > small[:, 0]) & (np.abs(span) > small[:, 0]))
    near_ends, place, height = near_ends[candidates], place[candidates], height[candidates]
    far_ends = (near_ends - place[:, :1]) / span[candidates, None]
    heights = height[:, :1] + far_ends * (height[:, 1:] - height[:, :1])
    close = (np.abs(heights) <= sides.tolerance).all(axis=1)
    slack = sides.tolerance / np.linalg.norm(ends[1] - ends[0])
    far_ends = np.where(np.abs(far_ends) < slack, 0.0, np.where(np.abs(far_ends - 1.0) < slack, 1.0, far_ends))
    near = candidates[close].astype(np.int64)
    return np.full(len(near), edge, dtype=np.int64), near, near_ends[close], far_ends[close]


def _moments(pieces: Overlaps, place: int, other: int, pinned: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Integral of psi of a near edge's end times N of a far edge's over each piece, near edges of length 1.

    pinned: (n, 2), whether each end has no multiplier. Quadratic along a piece: Simpson's rule is exact.
    """
    total = np.zeros(len(pieces.near))
    for share, weight in ((0.0, 1.0), (0.5, 4.0), (1.0, 1.0)):
        t, s = (ends[:, 0] + share * (ends[:, 1] - ends[:, 0]) for ends in (pieces.near_ends, pieces.far_ends))
        psi = 3.0 * t - 1.0 if place else 2.0 - 3.0 * t
        psi = np.where(pinned[:, place], 0.0, np.where(pinned[:, 1 - place], 1.0, psi))
        total += weight / 6.0 * psi * (s if other else 1.0 - s)
    return total * (pieces.near_ends[:, 1] - pieces.near_ends[:, 0])


def _half_edges(sides: Sides, edges: NDArray[np.int64], length: NDArray[np.float64]) -> sparse.csr_matrix:
    """Integral of N of an edge's one end, against the multiplier 1 of the other: half the length, both ways."""
    a, b = sides.near_edges[edges].T
    n = len(sides.near_nodes)
    half = length[edges] / 2
    return sparse.csr_matrix((np.concatenate([half, half]), (np.concatenate([a, b]), np.concatenate([b, a]))),
                             shape=(n, n))


def _corners(sides: Sides, edges: NDArray[np.int64], far: NDArray[np.int64]) -> sparse.csr_matrix:
    """1 where a near node at which the line of near edges ends or bends is one of far nodes, (n_near, n_far)."""
    ends = sides.near_edges[edges]
    along = sides.near_nodes[ends[:, 1]] - sides.near_nodes[ends[:, 0]]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    # The directions that leave a node add up to nothing on a straight line.
    total = np.zeros(sides.near_nodes.shape)
    np.add.at(total, ends[:, 0], along)
    np.add.at(total, ends[:, 1], -along)
    near = np.flatnonzero(np.linalg.norm(total, axis=1) > STRAIGHT)
    distance, nearest = cKDTree(sides.far_nodes[far]).query(sides.near_nodes[near])
    same = distance <= sides.tolerance
    return sparse.csr_matrix((np.ones(int(same.sum())), (near[same], far[nearest[same]])),
                             shape=(len(sides.near_nodes), len(sides.far_nodes)))
