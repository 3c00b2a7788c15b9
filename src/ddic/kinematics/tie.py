"""Nodes whose displacement is that of others: a mesh tied to one that it does not match."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse


@dataclass(frozen=True)
class Tie:
    """Displacements of a subdomain's mesh nodes from those of its unknown nodes.

    nodes: of the unknowns, (n_unknown_nodes, dim), pixels; matrix: (n_mesh_dofs, n_dofs), 1 on the nodes that are
    both; inverse: (n_dofs, n_mesh_dofs), the unknowns that fit displacements of the mesh nodes in least squares.
    """

    nodes: NDArray[np.float64]
    matrix: sparse.csr_matrix
    inverse: sparse.csr_matrix


def tie(nodes: NDArray[np.float64], weights: sparse.csr_matrix) -> Tie:
    """Tie mesh nodes to unknown nodes; weights: (n_mesh_nodes, n_unknown_nodes), rows that add up to 1.

    A row with one entry 1 is a node that is free; other rows are slaves, whose columns that no free node has must be
    independent.
    """
    counts = np.diff(weights.indptr)
    owner = np.full(weights.shape[1], -1)
    alone = np.flatnonzero(counts == 1)
    owner[weights.indices[weights.indptr[alone]]] = alone
    masters, slaves = np.flatnonzero(owner < 0), np.flatnonzero(counts > 1)
    fit = np.linalg.pinv(weights[slaves][:, masters].toarray())
    known = np.flatnonzero(owner >= 0)
    ones = sparse.csr_matrix((np.ones(len(known)), (known, owner[known])), shape=weights.shape[::-1])
    place = sparse.csr_matrix((np.ones(len(masters)), (masters, np.arange(len(masters)))),
                              shape=(weights.shape[1], len(masters)))
    pick = sparse.csr_matrix((np.ones(len(slaves)), (np.arange(len(slaves)), slaves)),
                             shape=(len(slaves), weights.shape[0]))
    # What the known nodes leave of the slaves is the masters'.
    rest = pick - weights[slaves] @ ones
    inverse = ones + place @ sparse.csr_matrix(fit) @ rest
    axes = sparse.identity(nodes.shape[1], format="csr")
    return Tie(nodes, sparse.kron(weights, axes).tocsr(), sparse.kron(inverse, axes).tocsr())
