"""How many subdomains share each node and unknown, counted over the whole mesh."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.kinematics.kinematics import RegionKinematics
from ddic.mesh.mesh import Mesh


def count_sharers_of_nodes(mesh: Mesh, parts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Subdomains at each node, (n_nodes,), from the subdomain of each cell."""
    seen = np.zeros((mesh.n_nodes, int(parts.max()) + 1), dtype=bool)
    seen[mesh.connectivity, np.repeat(parts, np.diff(mesh.offsets))] = True
    return np.asarray(seen.sum(axis=1))


def count_sharers(region: RegionKinematics, parts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Subdomains at each unknown, (n_unknowns,): those with a node that it displaces."""
    mesh = region.mesh
    seen = np.zeros((region.n_unknowns, int(parts.max()) + 1), dtype=bool)
    for cell, part in enumerate(parts):
        seen[region.unknowns_at(mesh.get_cell(cell))[0], part] = True
    return np.asarray(seen.sum(axis=1))
