"""Split the cells of a mesh into subdomains."""

from __future__ import annotations

import numpy as np
import pymetis
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.mesh.mesh import Mesh
from ddic.mesh.topology import cell_adjacency

MEAN_WEIGHT = 1000.0
LARGEST_SUM = 2.0**30


def split_by_metis(mesh: Mesh, n_subdomains: int, weights: NDArray[np.float64] | None = None) -> NDArray[np.int64]:
    """Split by METIS on the graph of cells that share a facet; weights (n_cells,), of any scale, are balanced.

    Returns the subdomain of each cell (n_cells,). Raises InputError where a subdomain would be empty.
    """
    if n_subdomains == 1:
        return np.zeros(mesh.n_cells, dtype=np.int64)
    if n_subdomains > mesh.n_cells:
        raise InputError(f"solver.subdomains: {n_subdomains} asked for, but the mesh has only "
                         f"{mesh.n_cells} cells; ask for fewer")
    indptr, indices = cell_adjacency(mesh)
    # Several tries and passes: ragged interfaces cost Krylov iterations in every step.
    options = pymetis.Options(seed=1, ncuts=8, niter=50)
    _, parts = pymetis.part_graph(
        n_subdomains, adjacency=pymetis.CSRAdjacency(indptr, indices), recursive=n_subdomains <= 8, options=options,
        vweights=None if weights is None else _whole_weights(weights).tolist(),
    )
    return renumber(np.asarray(parts, dtype=np.int64), n_subdomains)


def _whole_weights(weights: NDArray[np.float64]) -> NDArray[np.int64]:
    """Weights as whole numbers of at least 1: METIS knows no others, and adds them up in 32 bits."""
    unit = max(float(np.mean(weights)) / MEAN_WEIGHT, float(np.sum(weights)) / LARGEST_SUM)
    return np.maximum(np.rint(weights / unit), 1).astype(np.int64) if unit > 0 else np.ones(len(weights), np.int64)


def split_by_blocks(mesh: Mesh, blocks: tuple[int, ...]) -> NDArray[np.int64]:
    """Split into a regular array of blocks (columns, rows) of the bounding box, by the cells' centroids.

    Blocks that hold no cell are dropped. Returns the subdomain of each cell (n_cells,).
    """
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    counts = np.asarray(blocks)
    place = np.floor((mesh.centroids - low) / (high - low) * counts).astype(np.int64)
    place = np.clip(place, 0, counts - 1)
    number = np.zeros(mesh.n_cells, dtype=np.int64)
    for axis in reversed(range(mesh.dim)):
        number = number * counts[axis] + place[:, axis]
    return np.unique(number, return_inverse=True)[1].reshape(-1).astype(np.int64)


def renumber(parts: NDArray[np.int64], n_expected: int) -> NDArray[np.int64]:
    """Number the subdomains 0, 1, ... without gaps; raises InputError where there are fewer than expected."""
    present, parts = np.unique(parts, return_inverse=True)
    if len(present) < n_expected:
        raise InputError(f"solver.subdomains: only {len(present)} of {n_expected} subdomains got cells; ask for fewer")
    return parts.reshape(-1).astype(np.int64)
