"""Split the cells of a mesh into subdomains."""

from __future__ import annotations

import numpy as np
import pymetis
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.mesh.mesh import Mesh
from ddic.mesh.topology import find_adjacent_cells

MEAN_WEIGHT = 1000.0
"""Mean of the whole numbers that METIS gets for weights; a larger value rounds them less."""

LARGEST_SUM = 2.0**30
"""Largest sum of these numbers, which METIS adds up in 32 bits with a sign."""

N_CUTS, N_PASSES = 8, 50
"""METIS's tries, of which the best is kept, and passes of refinement: ragged interfaces cost Krylov iterations in every
step. Larger values take longer."""

MOST_BISECTED = 8
"""Most subdomains that are found by repeated halving, as METIS's manual advises for few parts; more are cut at once."""


def split_by_metis(mesh: Mesh, n_subdomains: int, weights: NDArray[np.float64] | None = None) -> NDArray[np.int64]:
    """Split by METIS on the graph of cells that share a facet; what it leaves empty gets a cell of the largest part.

    Parameters
    ----------
    mesh : Mesh
        Any.
    n_subdomains : int
        How many.
    weights : (n_cells,) array, optional
        What is balanced, of any scale; by default the number of cells.

    Returns
    -------
    (n_cells,) int64 array
        Subdomain of each cell.

    Raises
    ------
    InputError
        Where there are fewer cells than subdomains.
    """
    if n_subdomains == 1:
        return np.zeros(mesh.n_cells, dtype=np.int64)
    if n_subdomains > mesh.n_cells:
        raise InputError(f"mesh: {mesh.n_cells} cells for {n_subdomains} subdomains, one a rank at least; start fewer "
                         "ranks, use smaller elements, or ask for fewer subdomains (solver.subdomains)")
    indptr, indices = find_adjacent_cells(mesh)
    _, parts = pymetis.part_graph(
        n_subdomains,
        adjacency=pymetis.CSRAdjacency(indptr, indices),
        recursive=n_subdomains <= MOST_BISECTED,
        options=pymetis.Options(seed=1, ncuts=N_CUTS, niter=N_PASSES),
        vweights=None if weights is None else _whole_weights(weights).tolist(),
    )
    return _fill_empty(np.asarray(parts, dtype=np.int64), n_subdomains, (indptr, indices))


def split_by_blocks(mesh: Mesh, blocks: tuple[int, ...]) -> NDArray[np.int64]:
    """Split into a regular array of blocks of the bounding box, by the cells' centroids.

    Parameters
    ----------
    mesh : Mesh
        Any.
    blocks : tuple of dim ints
        Number of blocks along each axis; those that hold no cell are dropped.

    Returns
    -------
    (n_cells,) int64 array
        Subdomain of each cell.
    """
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    counts = np.asarray(blocks)
    place = np.floor((mesh.centroids - low) / (high - low) * counts).astype(np.int64)
    place = np.clip(place, 0, counts - 1)
    # The first axis varies fastest.
    number = np.zeros(mesh.n_cells, dtype=np.int64)
    for axis in reversed(range(mesh.dim)):
        number = number * counts[axis] + place[:, axis]
    return renumber(number)


def renumber(parts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number the subdomains 0, 1, ... without gaps.

    Parameters
    ----------
    parts : (n_cells,) int64 array
        Subdomain of each cell.

    Returns
    -------
    (n_cells,) int64 array
        Subdomain of each cell, in the old order.
    """
    _, places = np.unique(parts, return_inverse=True)
    return np.asarray(places, dtype=np.int64).reshape(-1)


def _fill_empty(parts: NDArray[np.int64], n_subdomains: int,
                adjacent: tuple[NDArray[np.int64], NDArray[np.int64]]) -> NDArray[np.int64]:
    """Give each subdomain without cells that cell of the largest one which has fewest neighbours there.

    METIS leaves some empty where there are few cells for each.
    """
    indptr, indices = adjacent
    filled, counts = parts.copy(), np.bincount(parts, minlength=n_subdomains)
    for empty in np.flatnonzero(counts == 0):
        largest = int(counts.argmax())
        cells = np.flatnonzero(filled == largest)
        n_beside = [int((filled[indices[indptr[cell]:indptr[cell + 1]]] == largest).sum()) for cell in cells]
        filled[cells[int(np.argmin(n_beside))]] = empty
        counts[largest] -= 1
        counts[empty] = 1
    return filled


def _whole_weights(weights: NDArray[np.float64]) -> NDArray[np.int64]:
    """Weights as whole numbers of at least 1: METIS knows no others."""
    unit = max(float(np.mean(weights)) / MEAN_WEIGHT, float(np.sum(weights)) / LARGEST_SUM)
    if unit <= 0:
        return np.ones(len(weights), np.int64)
    return np.asarray(np.maximum(np.rint(weights / unit), 1), dtype=np.int64)
