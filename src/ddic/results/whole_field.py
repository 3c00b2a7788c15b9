"""A measured displacement gathered on rank 0."""

from __future__ import annotations

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
    own = [(subdomain.node_ids, u.reshape(-1, subdomain.mesh.dim))
           for subdomain, u in zip(measurement.subdomains, measurement.displacements, strict=True)]
    gathered = measurement.team.gather_to(own, 0)
    if gathered is None:
        return None
    displacement = np.empty((measurement.region.n_nodes, own[0][1].shape[1]))
    for of_rank in gathered:
        for nodes, u in of_rank:
            displacement[nodes] = u
    return displacement
