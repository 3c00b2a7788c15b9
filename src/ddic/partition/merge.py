"""Join subdomains that cannot stand alone with a neighbour that can."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph


def connected_pieces(adjacency: tuple[NDArray[np.int64], NDArray[np.int64]]) -> NDArray[np.int64]:
    """Piece of each cell (n_cells,), from 0: cells that facets connect; adjacency: as ``cell_adjacency`` gives it.

    A node alone is a hinge: mechanics do not hold one piece by another at it.
    """
    indptr, indices = adjacency
    shape = (len(indptr) - 1, len(indptr) - 1)
    graph = sparse.csr_matrix((np.ones(len(indices), dtype=np.int64), indices, indptr), shape=shape)
    return np.asarray(csgraph.connected_components(graph, directed=False)[1], dtype=np.int64)


def merge_blank(pieces: NDArray[np.int64], owner: NDArray[np.int64],
                adjacency: tuple[NDArray[np.int64], NDArray[np.int64]], blank: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Join every connected group of blank pieces with the textured one that shares most facets with it.

    A group without a textured neighbour (a piece of the mesh by itself) stays as it is. Of neighbours with equally
    many facets the lowest is taken. Load is no criterion: pixels without texture cost a residual pass but no
    iteration, and a part of the mesh that nothing holds but its neighbour must be with it, however large it is.

    pieces: (n_cells,) connected piece of each cell; owner: (n_pieces,) subdomain of each piece; adjacency: (indptr,
    indices) of the cells that share a facet (``cell_adjacency``); blank: (n_pieces,). Returns the new subdomain of
    each cell (n_cells,), from 0 without gaps, in the old order.
    """
    shared = _shared_facets(pieces, adjacency, len(blank))
    host = np.arange(len(blank))
    numbers = np.flatnonzero(blank)
    n_groups, group = csgraph.connected_components(shared[numbers][:, numbers], directed=False)
    for g in range(n_groups):
        members = numbers[group == g]
        facets = np.asarray(shared[members].sum(axis=0)).ravel() * ~blank
        if facets.any():
            host[members] = int(facets.argmax())
    new = np.unique(owner[host][pieces], return_inverse=True)[1]
    return np.asarray(new.reshape(-1), dtype=np.int64)


def _shared_facets(pieces: NDArray[np.int64], adjacency: tuple[NDArray[np.int64], NDArray[np.int64]],
                   n_pieces: int) -> sparse.csr_matrix:
    """Number of facets that each two different pieces share, (n_pieces, n_pieces)."""
    indptr, indices = adjacency
    one, other = np.repeat(pieces, np.diff(indptr)), pieces[indices]
    apart = one != other
    counts = np.ones(int(apart.sum()), dtype=np.int64)
    shape = (n_pieces, n_pieces)
    return sparse.csr_matrix((counts, (one[apart], other[apart])), shape=shape)
