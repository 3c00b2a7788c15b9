"""Spread subdomains over ranks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain

HALVINGS = 60
"""Halvings of the interval that holds the smallest possible largest cost: enough for the last bit of a float, and more
change nothing."""


def split_evenly(costs: NDArray[np.float64], n_ranks: int) -> list[range]:
    """Split subdomains into contiguous ranges, one a rank, whose largest cost is the least possible.

    Within that, ranges are as equal as they can be from the first on.

    Parameters
    ----------
    costs : (n_subdomains,) array
        Work of each subdomain, in any unit.
    n_ranks : int
        Number of ranks.

    Returns
    -------
    list of range
        Each rank's subdomains.

    Raises
    ------
    InputError
        Where a rank would get none.
    """
    n = len(costs)
    if n_ranks > n:
        raise InputError(f"{n_ranks} MPI ranks for {n} subdomains: every rank needs at least one; "
                         f"start at most {n} ranks or ask for more subdomains (solver.subdomains)")
    before = np.concatenate([[0.0], np.cumsum(costs)])
    limit = _smallest_limit(before, float(np.max(costs)), n_ranks)
    furthest = _furthest(before, limit)
    ranks_needed = np.zeros(n + 1, dtype=np.int64)
    for begin in reversed(range(n)):
        ranks_needed[begin] = 1 + ranks_needed[furthest[begin]]
    ranges, begin = [], 0
    for left in range(n_ranks, 0, -1):
        # The rest must fit on the ranks left, and give each of them one.
        latest = min(int(furthest[begin]), n - (left - 1))
        earliest = max(int(np.searchsorted(-ranks_needed, -(left - 1))), begin + 1)
        even_share = (before[n] - before[begin]) / left
        nearest = int(np.abs(before - (before[begin] + even_share)).argmin())
        end = min(max(nearest, earliest), latest)
        ranges.append(range(begin, end))
        begin = end
    return ranges


def _furthest(before: NDArray[np.float64], limit: float) -> NDArray[np.int64]:
    """Return where a range that begins at each subdomain ends at the latest, (n_subdomains,)."""
    ends = np.searchsorted(before, before[:-1] + limit, side="right") - 1
    return np.asarray(np.maximum(ends, np.arange(1, len(before))), dtype=np.int64)


def _smallest_limit(before: NDArray[np.float64], low: float, n_ranks: int) -> float:
    """Return the smallest largest cost of n_ranks ranges; low: cost of the largest subdomain, which is never more."""
    high = float(before[-1])
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        furthest, end, n_used = _furthest(before, middle), 0, 0
        while end < len(before) - 1 and n_used <= n_ranks:
            end, n_used = int(furthest[end]), n_used + 1
        if n_used <= n_ranks and end == len(before) - 1:
            high = middle
        else:
            low = middle
    return high


def scatter_subdomains(team: Team, build: Callable[[], tuple[list[Subdomain], NDArray[np.float64]]],
                       ) -> list[Subdomain]:
    """Build all subdomains on rank 0 and give each rank its own; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    build : callable
        Runs on rank 0 alone; returns all subdomains and the work of each, of shape (n_subdomains,).

    Returns
    -------
    list of Subdomain
        This rank's, in their order.

    Raises
    ------
    InputError
        On all ranks, where there are fewer subdomains than ranks; and what ``build`` raises.
    """
    def share() -> list[list[Subdomain]]:
        subdomains, costs = build()
        return [[subdomains[s] for s in part] for part in split_evenly(costs, team.size)]

    return team.scatter_from_root(share)
