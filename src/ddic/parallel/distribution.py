"""Spread subdomains over ranks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain

HALVINGS = 60
"""Of the interval that holds the smallest possible largest load: to the last bit of a float."""


def owners(costs: NDArray[np.float64], n_ranks: int) -> list[range]:
    """Contiguous ranges of subdomains, one per rank, whose largest cost is the least possible.

    costs: work of each subdomain, (n_subdomains,). Within that, ranges are as equal as they can be from the first on.
    Raises InputError where a rank gets none.
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
        goal = before[begin] + (before[n] - before[begin]) / left
        end = min(max(int(np.abs(before - goal).argmin()), earliest), latest)
        ranges.append(range(begin, end))
        begin = end
    return ranges


def _furthest(before: NDArray[np.float64], limit: float) -> NDArray[np.int64]:
    """Where a range that begins at each subdomain ends at the latest, (n_subdomains,)."""
    ends = np.searchsorted(before, before[:-1] + limit, side="right") - 1
    return np.asarray(np.maximum(ends, np.arange(1, len(before))), dtype=np.int64)


def _smallest_limit(before: NDArray[np.float64], low: float, n_ranks: int) -> float:
    """Smallest largest cost of n_ranks ranges; low: cost of the largest subdomain, which is never more."""
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


def distribute(team: Team, build: Callable[[], tuple[list[Subdomain], NDArray[np.float64]]]) -> list[Subdomain]:
    """Build all subdomains and their costs (n_subdomains,) on rank 0 and give each rank its own."""
    def share() -> list[list[Subdomain]]:
        subdomains, costs = build()
        return [[subdomains[s] for s in part] for part in owners(costs, team.size)]

    return team.scatter_from_root(share)
