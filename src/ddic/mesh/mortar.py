"""Mortar between the edges of two meshes that touch along a line where their nodes need not meet."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import sparse

from ddic.arrays import Array, BoolArray, IntArray
from ddic.mesh.plane import build_tree, multiply_across

NOTHING = 1e-14
"""Weight below which a master is none: rounding. A larger value drops masters that matter."""

STRAIGHT = 1e-6
"""Angle below which a line of edges does not bend, radians; a larger value leaves corners without a pinned node."""

SIMPSON = ((0.0, 1 / 6), (0.5, 4 / 6), (1.0, 1 / 6))
"""Places and weights of Simpson's rule on a piece of length 1: exact for quadratic functions."""


@dataclass(frozen=True)
class Sides:
    """The two sides that may touch.

    Attributes
    ----------
    far_nodes, near_nodes : (n_nodes, 2) array
        Pixels.
    far_edges, near_edges : (n_edges, 2) int64 array
        Straight edges, by the nodes of their ends.
    tolerance : float
        Distance below which points are one, pixels.
    """

    far_nodes: Array
    far_edges: IntArray
    near_nodes: Array
    near_edges: IntArray
    tolerance: float


class Overlaps(NamedTuple):
    """Pieces of a line that a far and a near edge have in common.

    Attributes
    ----------
    far, near : (n,) int64 arrays
        The edges of each piece.
    near_ends, far_ends : (n, 2) arrays
        Where a piece begins and ends on each of them, 0 to 1 along it.
    """

    far: IntArray
    near: IntArray
    near_ends: Array
    far_ends: Array

    def measure_far_cover(self, n_edges: int) -> Array:
        """Measure the share of each of ``n_edges`` far edges that near edges cover, 0 to 1."""
        lengths = np.abs(np.diff(self.far_ends)[:, 0])
        return np.asarray(np.bincount(self.far, lengths, n_edges), dtype=np.float64)

    def measure_near_cover(self, n_edges: int) -> Array:
        """Measure the share of each of ``n_edges`` near edges that far edges cover, 0 to 1."""
        lengths = np.diff(self.near_ends)[:, 0]
        return np.asarray(np.bincount(self.near, lengths, n_edges), dtype=np.float64)


@dataclass(frozen=True)
class Mortar:
    """Displacements of near nodes on the common line (slaves) from those of far nodes (masters): u = P u_far.

    Attributes
    ----------
    slaves : (n,) int64 array
        Sorted near nodes.
    weights : (n, n_far_nodes) csr_matrix
        P.
    """

    slaves: IntArray
    weights: sparse.csr_matrix


def find_overlaps(sides: Sides) -> Overlaps:
    """Find where far edges run along near edges: their common pieces, in order of the far edges."""
    near = _lines(sides.near_nodes, sides.near_edges)
    pieces = [Overlaps(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2)))]
    for k, ends in enumerate(sides.far_nodes[sides.far_edges]):
        pieces.append(_overlap_edge(k, ends, near, sides.tolerance))
    return Overlaps(*(np.concatenate(of_pieces) for of_pieces in zip(*pieces, strict=True)))


def integrate_mortar(sides: Sides, pieces: Overlaps) -> Mortar:
    """Integrate P with dual multipliers on the near edges, exactly; all pieces of an edge must cover it.

    int psi_i (u_near - u_far) = 0 with psi_1 = 2 N_1 - N_2, psi_2 = 2 N_2 - N_1 on each near edge, which makes int
    psi_i N_j diagonal (B. I. Wohlmuth, SIAM J. Numer. Anal. 38 (2000) 989-1012), so that every slave depends on the far
    edges beside it. Where the line ends or bends, the slave is the far node there and has no multiplier; on its edges
    the neighbours' are then 1. Constant and linear fields are kept, and P^T passes on what a constant stress makes of
    forces, whose direction changes with the line's.
    """
    edges = np.unique(pieces.near)
    slaves = np.unique(sides.near_edges[edges])
    length = _lines(sides.near_nodes, sides.near_edges).length
    at_corners = _corners(sides, edges, np.unique(sides.far_edges[pieces.far]))
    corners = np.flatnonzero(np.diff(at_corners.indptr))
    pinned = np.isin(sides.near_edges, corners)
    # Row i of int psi_i (u_near - u_far) = 0 reads mass_i u_i + (beside u_corners)_i = (to_far u_far)_i.
    to_far = _multipliers_times_far(sides, pieces, pinned, length)
    beside = _multipliers_times_corners(sides, edges[pinned[edges].any(axis=1)], length)
    mass = np.bincount(sides.near_edges[edges].ravel(), np.repeat(length[edges] / 2, 2), len(sides.near_nodes))
    # Corners have no equation: they are far nodes.
    without_equation = mass <= 0
    without_equation[corners] = True
    inverse = sparse.diags(1.0 / np.where(without_equation, np.inf, mass))
    weights = (inverse @ (to_far - beside @ at_corners) + at_corners).tocsr()[slaves]
    weights.data[np.abs(weights.data) < NOTHING] = 0.0
    weights.eliminate_zeros()
    return Mortar(slaves, weights)


@dataclass(frozen=True)
class _Lines:
    """Straight edges: where each begins (n, 2), the vector along it (n, 2) and its length (n,), pixels."""

    begin: Array
    along: Array
    length: Array


def _lines(nodes: Array, edges: IntArray) -> _Lines:
    """The edges as vectors."""
    begin = nodes[edges[:, 0]]
    along = nodes[edges[:, 1]] - begin
    return _Lines(begin, along, np.linalg.norm(along, axis=1))


def _overlap_edge(far: int, ends: Array, near: _Lines, tolerance: float) -> Overlaps:
    """Pieces that one far edge, whose ends (2, 2) are given, has in common with near edges."""
    # Of both ends in the frame of every near edge: its place along the edge, 0 to 1, and its height above it, pixels.
    along, length = near.along[:, None], near.length[:, None]
    apart = ends[None] - near.begin[:, None]
    place = (apart * along).sum(axis=2) / length**2
    height = multiply_across(along, apart) / length
    small = tolerance / near.length
    near_ends = _round_to_ends(np.clip(np.sort(place, axis=1), 0.0, 1.0), small[:, None])
    span = place[:, 1] - place[:, 0]
    long_enough = (near_ends[:, 1] - near_ends[:, 0] > small) & (np.abs(span) > small)
    candidates = np.flatnonzero(long_enough)
    near_ends, place, height = near_ends[candidates], place[candidates], height[candidates]
    # Where the piece ends on the far edge, and how high that is above the near one.
    far_ends = (near_ends - place[:, :1]) / span[candidates, None]
    heights = height[:, :1] + far_ends * (height[:, 1:] - height[:, :1])
    close = (np.abs(heights) <= tolerance).all(axis=1)
    far_length = float(np.linalg.norm(ends[1] - ends[0]))
    far_ends = _round_to_ends(far_ends[close], tolerance / far_length)
    found = candidates[close].astype(np.int64)
    return Overlaps(np.full(len(found), far, dtype=np.int64), found, near_ends[close], far_ends)


def _round_to_ends(place: Array, small: Array | float) -> Array:
    """Places along an edge, those that are nearly at 0 or 1 put there."""
    return np.where(np.abs(place) < small, 0.0, np.where(np.abs(place - 1.0) < small, 1.0, place))


def _multipliers_times_far(sides: Sides, pieces: Overlaps, pinned: BoolArray, length: Array) -> sparse.csr_matrix:
    """Integrals of psi of near nodes times N of far nodes, (n_near_nodes, n_far_nodes), pixels."""
    shape = (len(sides.near_nodes), len(sides.far_nodes))
    total = sparse.csr_matrix(shape)
    for near_end in range(2):
        for far_end in range(2):
            values = _moments(pieces, near_end, far_end, pinned[pieces.near]) * length[pieces.near]
            rows = sides.near_edges[pieces.near, near_end]
            columns = sides.far_edges[pieces.far, far_end]
            total = total + sparse.csr_matrix((values, (rows, columns)), shape=shape)
    return total


def _moments(pieces: Overlaps, near_end: int, far_end: int, pinned: BoolArray) -> Array:
    """Integral of psi of a near edge's end times N of a far edge's over each piece, near edges of length 1.

    pinned: (n, 2), whether each end has no multiplier. The product is quadratic along a piece.
    """
    other_end = 1 - near_end
    total = np.zeros(len(pieces.near))
    for share, weight in SIMPSON:
        t = _between(pieces.near_ends, share)
        s = _between(pieces.far_ends, share)
        psi = 3.0 * t - 1.0 if near_end == 1 else 2.0 - 3.0 * t
        psi = np.where(pinned[:, near_end], 0.0, np.where(pinned[:, other_end], 1.0, psi))
        shape = s if far_end == 1 else 1.0 - s
        total += weight * psi * shape
    return total * (pieces.near_ends[:, 1] - pieces.near_ends[:, 0])


def _between(ends: Array, share: float) -> Array:
    """The place at a share of the way from the first to the second end, (n,)."""
    return np.asarray(ends[:, 0] + share * (ends[:, 1] - ends[:, 0]))


def _multipliers_times_corners(sides: Sides, edges: IntArray, length: Array) -> sparse.csr_matrix:
    """Integral of N of an edge's one end, against the multiplier 1 of the other: half the length, both ways."""
    a, b = sides.near_edges[edges].T
    n = len(sides.near_nodes)
    half = length[edges] / 2
    rows, columns = np.concatenate([a, b]), np.concatenate([b, a])
    return sparse.csr_matrix((np.concatenate([half, half]), (rows, columns)), shape=(n, n))


def _corners(sides: Sides, edges: IntArray, far: IntArray) -> sparse.csr_matrix:
    """1 where a near node at which the line of near edges ends or bends is one of far nodes, (n_near, n_far)."""
    lines = _lines(sides.near_nodes, sides.near_edges[edges])
    direction = lines.along / lines.length[:, None]
    # The directions that leave a node add up to nothing on a straight line.
    total = np.zeros(sides.near_nodes.shape)
    np.add.at(total, sides.near_edges[edges, 0], direction)
    np.add.at(total, sides.near_edges[edges, 1], -direction)
    near = np.flatnonzero(np.linalg.norm(total, axis=1) > STRAIGHT)
    distance, nearest = build_tree(sides.far_nodes[far]).query(sides.near_nodes[near])
    same = distance <= sides.tolerance
    return sparse.csr_matrix((np.ones(int(same.sum())), (near[same], far[nearest[same]])),
                             shape=(len(sides.near_nodes), len(sides.far_nodes)))
