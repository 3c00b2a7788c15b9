"""A measured displacement gathered on rank 0."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ddic.results.measurement import Measurement


def gather_displacement(measurement: Measurement) -> NDArray[np.float64] | None:
    """Gather the displacement of all nodes; collective.

    Parameters
    ----------
    measurement : Measurement
        Spread over ranks.

    Returns
    -------
    (n_nodes, dim) array or None
        Pixels, on rank 0.
    """
    values = [(subdomain.node_ids, u.reshape(-1, subdomain.mesh.dim))
              for subdomain, u in zip(measurement.subdomains, measurement.displacements, strict=True)]
    gathered = measurement.team.gather_to(values, 0)
    if gathered is None:
        return None
    return place_at_nodes([of_subdomain for of_rank in gathered for of_subdomain in of_rank],
                          measurement.region.n_nodes)


def place_at_nodes(values: Iterable[tuple[NDArray[np.int64], NDArray[np.float64]]],
                   n_nodes: int) -> NDArray[np.float64]:
    """Put the values of several parts of a mesh in their places.

    Parameters
    ----------
    values : iterable of (node_ids, (n, dim) array)
        Of each part: numbers of its nodes in the whole mesh, and a vector of each.
    n_nodes : int
        Of the whole mesh.

    Returns
    -------
    (n_nodes, dim) array
        Where parts share a node, of the last; nan at nodes of no part.
    """
    placed = np.full((n_nodes, 2), np.nan)
    for node_ids, of_part in values:
        placed[node_ids] = of_part
    return placed
