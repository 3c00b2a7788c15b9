"""A partition in which every subdomain's slaves tell its masters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.errors import InputError
from ddic.mesh.mesh import Mesh
from ddic.partition.split import renumber
from ddic.partition.ties import Tying

LEAST = 0.1
"""Singular value of a subdomain's weights below which its slaves do not tell its masters: squared, the share of the
texture by which a master's displacement is held there."""


def with_told_masters(mesh: Mesh, tying: Tying, parts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Move cells with slaves from subdomains that have too few of them to a neighbour of the same near mesh.

    A subdomain's masters are unknowns there, which nothing but its slaves holds: with fewer slaves than masters, where
    it touches the boundary at a corner for instance, its operator would be singular. parts: (n_cells,). Returns the
    subdomain of each cell, numbered without gaps. Raises InputError where a whole near mesh has too few slaves.
    """
    owner = np.repeat(np.arange(mesh.n_cells), np.diff(mesh.offsets))
    tied = mesh.connectivity >= tying.n_unknown_nodes
    cells = np.unique(owner[tied])
    nodes = sparse.csr_matrix((np.ones(int(tied.sum())), (np.searchsorted(cells, owner[tied]),
                                                          mesh.connectivity[tied])), shape=(len(cells), mesh.n_nodes))
    parts = parts.copy()
    told: set[int] = set()
    while True:
        present = [int(s) for s in np.unique(parts[cells]) if int(s) not in told]
        if not present:
            return renumber(parts, 0)
        mine = parts[cells] == present[0]
        if _told(tying, nodes[mine]):
            told.add(present[0])
            continue
        same = ~mine & (tying.cameras[cells] == tying.cameras[cells[mine][0]])
        if not same.any():
            raise InputError(f"near, entry {int(tying.cameras[cells[mine][0]])}: its mesh has too few nodes on the "
                             "boundary with the far elements; use smaller near elements than far ones there")
        shared = nodes[mine].sum(axis=0) @ nodes.T
        # Cells without a common node are neighbours along the boundary only where nothing else is left.
        votes = np.bincount(parts[cells[same]], 1e-9 + np.asarray(shared).ravel()[same])
        target = int(votes.argmax())
        parts[cells[mine]] = target
        told.discard(target)


def _told(tying: Tying, nodes: sparse.csr_matrix) -> bool:
    """Whether the slaves of some cells tell their masters; nodes: (n_cells, n_nodes), the slaves of each cell."""
    weights = tying.weights[np.unique(nodes.indices)]
    block = weights[:, np.unique(weights.indices)].toarray()
    if block.shape[0] < block.shape[1]:
        return False
    return bool(np.linalg.svd(block, compute_uv=False)[-1] >= LEAST)
