"""Sums at nodes that several subdomains share, the same on all of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain

Array = NDArray[np.float64]


def sum_shared_nodes(team: Team, subdomains: Sequence[Subdomain], sums: Sequence[Array]) -> list[Array]:
    """Sum values at nodes over all subdomains that have them; collective.

    A node's values go to one rank, which adds them up in the order of subdomains and sends the sum back: only ranks
    that share nodes, and those that add up for them, exchange anything.

    Parameters
    ----------
    team : Team
        All ranks.
    subdomains : sequence of Subdomain
        This rank's.
    sums : sequence of (n_nodes, k) array
        Values at the nodes of each; left as they are.

    Returns
    -------
    list of (n_nodes, k) array
        The sums at the same nodes, equal to the last bit on all subdomains however they are spread over ranks.
    """
    shared = [np.flatnonzero(subdomain.node_multiplicity > 1) for subdomain in subdomains]
    # A rank always has a subdomain.
    nodes = np.concatenate([s.node_ids[places] for s, places in zip(subdomains, shared, strict=True)])
    order = np.concatenate([np.full(len(places), s.index) for s, places in zip(subdomains, shared, strict=True)])
    values = np.concatenate([of_subdomain[places] for of_subdomain, places in zip(sums, shared, strict=True)])
    adds_up = nodes % team.size
    sent = {int(rank): np.flatnonzero(adds_up == rank) for rank in np.unique(adds_up)}
    received = team.exchange({rank: (nodes[mine], order[mine], values[mine]) for rank, mine in sent.items()})
    returned = team.exchange(_add_up(received))
    total = np.empty_like(values)
    for rank, mine in sent.items():
        total[mine] = returned[rank]
    ends = np.cumsum([len(places) for places in shared])[:-1]
    result = []
    for of_subdomain, places, added in zip(sums, shared, np.split(total, ends), strict=True):
        whole = of_subdomain.copy()
        whole[places] = added
        result.append(whole)
    return result


def _add_up(received: dict[int, tuple[NDArray[np.int64], NDArray[np.int64], Array]]) -> dict[int, Array]:
    """Sums for each rank that sent (nodes, subdomains, values), in the order in which it sent its own."""
    if not received:
        return {}
    nodes, subdomains, values = (np.concatenate(arrays) for arrays in zip(*received.values(), strict=True))
    order = np.lexsort((subdomains, nodes))
    number = np.unique(nodes, return_inverse=True)[1]
    added = np.zeros((len(nodes), values.shape[1]))
    # One after the other, as no other sum of numpy promises.
    np.add.at(added, number[order], values[order])
    ends = np.cumsum([len(sent[0]) for sent in received.values()])[:-1]
    return dict(zip(received, np.split(added[number], ends), strict=True))
