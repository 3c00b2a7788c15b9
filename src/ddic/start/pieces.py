"""Pieces of a region: what hangs together by nodes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from ddic.mesh.mesh import Mesh


def find_pieces(mesh: Mesh) -> NDArray[np.int64]:
    """Find the pieces of a mesh: cells that hang together by nodes are of one.

    Parameters
    ----------
    mesh : Mesh
        Perhaps cut by lines.

    Returns
    -------
    (n_cells,) array of int64
        Piece of each cell, from 0.
    """
    cell_of_corner = np.repeat(np.arange(mesh.n_cells), np.diff(mesh.offsets))
    ones = np.ones(len(cell_of_corner))
    has_node = sparse.csr_matrix((ones, (cell_of_corner, mesh.connectivity)), (mesh.n_cells, mesh.n_nodes))
    _, pieces = connected_components(has_node @ has_node.T, directed=False)
    return np.asarray(pieces, dtype=np.int64)


def find_piece_of_nodes(mesh: Mesh) -> NDArray[np.int64]:
    """Find the piece of a mesh that each node is of.

    Parameters
    ----------
    mesh : Mesh
        Perhaps cut by lines; every node is a corner of a cell.

    Returns
    -------
    (n_nodes,) array of int64
        Piece, from 0, as ``find_pieces`` numbers them.
    """
    pieces = np.zeros(mesh.n_nodes, dtype=np.int64)
    pieces[mesh.connectivity] = np.repeat(find_pieces(mesh), np.diff(mesh.offsets))
    return pieces
