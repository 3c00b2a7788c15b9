"""The displacement of a mesh's nodes through displacements at points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ddic.mesh.interpolation import locate
from ddic.mesh.mesh import Mesh
from ddic.start.affine_map import AffineMap, fit_affine_map
from ddic.start.local_affine import N_NEIGHBOURS, fit_robustly
from ddic.start.pieces import find_piece_of_nodes, find_pieces

Array = NDArray[np.float64]

EXACT = 1e-9
"""What an affine map may leave of the displacements, pixels, to be taken for all of them: rounding."""

NODES_AT_ONCE = 50_000
"""Nodes whose neighbours are held at the same time: 100 MB."""


@dataclass(frozen=True, eq=False)
class PairField:
    """A displacement at the nodes of a mesh.

    Attributes
    ----------
    displacement : (n_nodes, 2) array
        Pixels.
    n_pieces_without : int
        Pieces of the mesh in which no point lies: they move with the affine map of the nearest point's piece.
    """

    displacement: Array
    n_pieces_without: int


def interpolate_pairs(points: Array, displacement: Array, mesh: Mesh) -> PairField:
    """Interpolate displacements at points, each piece of the mesh for itself.

    One point says a translation, two a rotation with a scale, three an affine map; what this leaves of more points is
    interpolated by affine maps of the nearest ones, of which some may be wrong.

    Parameters
    ----------
    points : (n, 2) array
        At least one, pixels.
    displacement : (n, 2) array
        Pixels.
    mesh : Mesh
        Perhaps cut by lines, pixels.

    Returns
    -------
    PairField
        At all nodes.
    """
    piece_of_node = find_piece_of_nodes(mesh)
    cells = locate(mesh, points).cells
    nearest_node = cKDTree(mesh.nodes).query(points)[1]
    piece_of_point = np.where(cells >= 0, find_pieces(mesh)[cells], piece_of_node[nearest_node])
    held = np.unique(piece_of_point)
    nearest_point = cKDTree(points).query(mesh.nodes)[1]
    from_piece = np.where(np.isin(piece_of_node, held), piece_of_node, piece_of_point[nearest_point])
    values = np.empty((mesh.n_nodes, 2))
    for piece in held:
        own, nodes = piece_of_point == piece, np.flatnonzero(from_piece == piece)
        of_piece = fit_affine_map(points[own], displacement[own])
        values[nodes] = of_piece.at(mesh.nodes[nodes])
        values[nodes] += _interpolate_rest(points[own], displacement[own], of_piece, mesh.nodes[nodes])
    return PairField(values, int(piece_of_node.max()) + 1 - len(held))


def _interpolate_rest(points: Array, displacement: Array, of_all: AffineMap, places: Array) -> Array:
    """What an affine map leaves of displacements, at places."""
    rest = displacement - of_all.at(points)
    values = np.zeros_like(places)
    if np.abs(rest).max() <= EXACT * max(1.0, float(np.abs(displacement).max())):
        return values
    tree, n_neighbours = cKDTree(points), min(N_NEIGHBOURS, len(points))
    for first in range(0, len(places), NODES_AT_ONCE):
        some = slice(first, first + NODES_AT_ONCE)
        near = tree.query(places[some], list(range(1, n_neighbours + 1)))[1]
        values[some] = fit_robustly(points[near] - places[some, None], rest[near])
    return values
