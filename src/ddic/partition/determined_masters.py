"""A partition in which every subdomain's slaves determine its masters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.errors import InputError
from ddic.mesh.mesh import Mesh
from ddic.partition.split import renumber
from ddic.partition.ties import Tying

LEAST = 0.1
"""Singular value of a subdomain's weights below which its slaves do not determine its masters: squared, the share of
the texture by which a master's displacement is held there. A larger value moves more cells."""


def keep_masters_determined(mesh: Mesh, tying: Tying, parts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Move cells with slaves from subdomains that have too few of them to a neighbour of the same near mesh.

    A subdomain's masters are unknowns there, which nothing but its slaves holds: with fewer slaves than masters, where
    it touches the boundary at a corner for instance, its operator would be singular.

    Parameters
    ----------
    mesh : Mesh
        The whole mesh.
    tying : Tying
        Which nodes are tied to which.
    parts : (n_cells,) array of int64
        Subdomain of each cell.

    Returns
    -------
    (n_cells,) array of int64
        New subdomain of each cell, numbered without gaps.

    Raises
    ------
    InputError
        Where a whole near mesh has too few slaves.
    """
    cells, slaves = _cells_with_slaves(mesh, tying)
    parts = parts.copy()
    determined: set[int] = set()
    while True:
        waiting = [int(s) for s in np.unique(parts[cells]) if int(s) not in determined]
        if not waiting:
            return renumber(parts)
        mine = parts[cells] == waiting[0]
        if _are_determined(tying, slaves[mine]):
            determined.add(waiting[0])
            continue
        camera = int(tying.cameras[cells[mine][0]])
        others = ~mine & (tying.cameras[cells] == camera)
        if not others.any():
            raise InputError(f"near, entry {camera}: its mesh has too few nodes on the boundary with the far elements; "
                             "use smaller near elements than far ones there")
        n_shared_nodes = np.asarray(slaves[mine].sum(axis=0) @ slaves.T).ravel()
        # Cells without a common node are neighbours along the boundary only where nothing else is left.
        votes = np.bincount(parts[cells[others]], 1e-9 + n_shared_nodes[others])
        target = int(votes.argmax())
        parts[cells[mine]] = target
        determined.discard(target)


def _cells_with_slaves(mesh: Mesh, tying: Tying) -> tuple[NDArray[np.int64], sparse.csr_matrix]:
    """Cells that have slaves, (n,), and 1 at the slaves of each of them, (n, n_nodes)."""
    owner = np.repeat(np.arange(mesh.n_cells), np.diff(mesh.offsets))
    is_slave = mesh.connectivity >= tying.n_unknown_nodes
    cells = np.unique(owner[is_slave])
    rows = np.searchsorted(cells, owner[is_slave])
    ones = np.ones(len(rows))
    return cells, sparse.csr_matrix((ones, (rows, mesh.connectivity[is_slave])), shape=(len(cells), mesh.n_nodes))


def _are_determined(tying: Tying, slaves: sparse.csr_matrix) -> bool:
    """Whether the slaves of some cells, (n_cells, n_nodes), determine their masters."""
    weights = tying.weights[np.unique(slaves.indices)]
    masters = np.unique(weights.indices)
    block = weights[:, masters].toarray()
    n_slaves, n_masters = block.shape
    if n_slaves < n_masters:
        return False
    return bool(np.linalg.svd(block, compute_uv=False)[-1] >= LEAST)
