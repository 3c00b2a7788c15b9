"""Which unknowns are held by pixels that a frame shows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain

CellCounts = tuple[NDArray[np.int64], ...]
"""Pixels of each cell, (n_cells,), by view of a subdomain."""


def find_held(subdomain: Subdomain, counts: CellCounts) -> NDArray[np.bool_]:
    """Find the unknowns that pixels hold: those that displace a node of a cell with pixels.

    Parameters
    ----------
    subdomain : Subdomain
        Its cells and unknowns.
    counts : tuple of (n_cells,) array
        Pixels of each cell, by view.

    Returns
    -------
    (n_field,) array of bool
        Whether pixels hold each unknown of the field.
    """
    return sum_pixels(subdomain, counts) > 0


def sum_pixels(subdomain: Subdomain, counts: CellCounts) -> NDArray[np.float64]:
    """Sum the pixels that see each unknown: those of the cells about the nodes that it displaces.

    Parameters
    ----------
    subdomain : Subdomain
        Its cells and unknowns.
    counts : tuple of (n_cells,) array
        Pixels of each cell, by view.

    Returns
    -------
    (n_field,) array
        Pixels, weighted by how far the unknown displaces each node.
    """
    mesh = subdomain.mesh
    n_pixels = np.sum(counts, axis=0)
    of_corners = np.repeat(n_pixels, np.diff(mesh.offsets))
    of_nodes = np.bincount(mesh.connectivity, weights=of_corners, minlength=mesh.n_nodes)
    return np.asarray(abs(subdomain.kinematics.tangent).T @ np.repeat(of_nodes, mesh.dim))


def find_displaced_nodes(subdomain: Subdomain, unknowns: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Find the nodes, (n_nodes,), that some unknowns of the field, (n_field,), displace."""
    is_displaced = abs(subdomain.kinematics.tangent) @ unknowns.astype(float) > 0
    return np.asarray(is_displaced.reshape(subdomain.mesh.nodes.shape).any(axis=1))


def find_free_unknowns(team: Team, subdomains: Sequence[Subdomain], unseen: Sequence[NDArray[np.bool_]]) -> set[int]:
    """Find the unknowns that no pixel holds in any subdomain; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    subdomains : sequence of Subdomain
        Owned ones.
    unseen : sequence of (n_field,) array of bool
        Their unknowns without pixels.

    Returns
    -------
    set of int
        Numbers in the whole problem, on all ranks.
    """
    copies = [copy for s, is_unseen in zip(subdomains, unseen, strict=True)
              for copy in zip(s.kinematics.numbers[is_unseen].tolist(), s.multiplicity[is_unseen].tolist(),
                              strict=True)]
    gathered = team.gather_lists(copies)
    n_copies = Counter(number for number, _ in gathered)
    # Held in none of the subdomains that share it.
    return {number for number, multiplicity in gathered if n_copies[number] == multiplicity}
