"""The size of a field: RMS displacement of nodes in pixels, whatever the unknowns mean."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain


def measure_rms(team: Team, subdomains: Sequence[Subdomain], unknowns: Sequence[NDArray[np.float64]]) -> float:
    """Measure the RMS displacement over nodes, every node counted once; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    subdomains : sequence of Subdomain
        This rank's.
    unknowns : sequence of (n_unknowns,) or (n_field,) arrays
        Of each of them, pixels.

    Returns
    -------
    float
        sqrt(mean of |u|^2 over nodes), pixels, the same on all ranks to the last bit however subdomains are spread.
    """
    sums = []
    for subdomain, q_s in zip(subdomains, unknowns, strict=True):
        u = subdomain.displacement(q_s).reshape(subdomain.mesh.nodes.shape)
        shares = 1.0 / subdomain.node_multiplicity
        sums.append(np.array([(u**2 * shares[:, None]).sum(), shares.sum()]))
    total, n_nodes = team.ordered_sum(sums)
    return float(np.sqrt(total / n_nodes))


def measure_unit_size(team: Team, subdomains: Sequence[Subdomain]) -> float:
    """Measure by how much independent unknowns of size one displace nodes; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    subdomains : sequence of Subdomain
        This rank's.

    Returns
    -------
    float
        sqrt(mean of |t|^2 over the field's unknowns / number of nodes) with t the columns of the whole tangent: times
        the norm of a vector of unknowns about its RMS displacement over nodes, pixels; exactly that for nodal unknowns.
    """
    squares, n_nodes, n_unknowns = 0.0, 0.0, 0
    for subdomain in subdomains:
        row_sums = np.asarray(subdomain.kinematics.tangent.power(2).sum(axis=1))
        shares = 1.0 / subdomain.node_multiplicity
        squares += float(row_sums.reshape(subdomain.mesh.nodes.shape).sum(axis=1) @ shares)
        n_nodes += float(shares.sum())
        n_unknowns += int(subdomain.owned[:subdomain.n_field].sum())
    total = team.sum(np.array([squares, n_nodes, n_unknowns]))
    return float(np.sqrt(total[0] / total[2] / total[1]))
