"""Join subdomains that cannot stand alone with a neighbour that can."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

Adjacency = tuple[NDArray[np.int64], NDArray[np.int64]]
"""Cells that share a facet, as compressed rows (indptr, indices): ``find_adjacent_cells``."""


def find_connected_pieces(adjacency: Adjacency) -> NDArray[np.int64]:
    """Find the pieces of a mesh whose cells facets connect.

    A node alone is a hinge: mechanics do not hold one piece by another at it.

    Parameters
    ----------
    adjacency : (indptr, indices)
        Cells that share a facet, as ``find_adjacent_cells`` gives it.

    Returns
    -------
    (n_cells,) int64 array
        Piece of each cell, from 0.
    """
    indptr, indices = adjacency
    n_cells = len(indptr) - 1
    ones = np.ones(len(indices), dtype=np.int64)
    graph = sparse.csr_matrix((ones, indices, indptr), shape=(n_cells, n_cells))
    _, pieces = csgraph.connected_components(graph, directed=False)
    return np.asarray(pieces, dtype=np.int64)


def merge_blank(pieces: NDArray[np.int64], owner: NDArray[np.int64], adjacency: Adjacency,
                blank: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Join every connected group of blank pieces with the textured one that shares most facets with it.

    A group without a textured neighbour (a piece of the mesh by itself) stays as it is. Of neighbours with equally
    many facets the lowest is taken. Load is no criterion: pixels without texture cost a residual pass but no
    iteration, and a part of the mesh that nothing holds but its neighbour must be with it, however large it is.

    Parameters
    ----------
    pieces : (n_cells,) int64 array
        Connected piece of each cell.
    owner : (n_pieces,) int64 array
        Subdomain of each piece.
    adjacency : (indptr, indices)
        Cells that share a facet, as ``find_adjacent_cells`` gives it.
    blank : (n_pieces,) bool array
        Pieces that cannot stand alone.

    Returns
    -------
    (n_cells,) int64 array
        New subdomain of each cell, from 0 without gaps, in the old order.
    """
    n_pieces = len(blank)
    n_shared = _count_shared_facets(pieces, adjacency, n_pieces)
    blank_pieces = np.flatnonzero(blank)
    among_blank = n_shared[blank_pieces][:, blank_pieces]
    n_groups, group_of = csgraph.connected_components(among_blank, directed=False)

    # The piece whose subdomain each piece will be part of.
    host = np.arange(n_pieces)
    for group in range(n_groups):
        members = blank_pieces[group_of == group]
        with_others = np.asarray(n_shared[members].sum(axis=0)).ravel()
        with_textured = np.where(blank, 0, with_others)
        if with_textured.any():
            host[members] = int(with_textured.argmax())

    owner_of_piece = owner[host]
    owner_of_cell = owner_of_piece[pieces]
    _, new = np.unique(owner_of_cell, return_inverse=True)
    return np.asarray(new.reshape(-1), dtype=np.int64)


def _count_shared_facets(pieces: NDArray[np.int64], adjacency: Adjacency, n_pieces: int) -> sparse.csr_matrix:
    """Number of facets that each two different pieces share, (n_pieces, n_pieces)."""
    indptr, indices = adjacency
    # Each pair of adjacent cells: the piece of one, the piece of the other.
    one = np.repeat(pieces, np.diff(indptr))
    other = pieces[indices]
    is_apart = one != other
    pairs = (one[is_apart], other[is_apart])
    ones = np.ones(len(pairs[0]), dtype=np.int64)
    # Entries of one place add up.
    return sparse.csr_matrix((ones, pairs), shape=(n_pieces, n_pieces))
