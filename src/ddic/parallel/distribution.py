"""Spread subdomains over ranks, and bring together what is spread.

Items of all ranks are brought to rank 0 one by one, so that it never holds all of them. Sums are taken at nodes that
several subdomains share, the same on all of them, and over bands of rows that are spread over ranks.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ddic.arrays import Array, IntArray
from ddic.errors import InputError
from ddic.functionals.grey_statistics import find_value_at
from ddic.parallel.team import Team
from ddic.partition.sharing import share_among_copies
from ddic.partition.subdomain import Subdomain
from ddic.separated.field import BandSums

HALVINGS = 60
"""Halvings of the interval that holds the smallest possible largest cost: enough for the last bit of a float, and more
change nothing."""


def split_evenly(costs: Array, n_ranks: int) -> list[range]:
    """Split subdomains into contiguous ranges, one a rank, whose largest cost, in any unit, is the least possible.

    Within that, ranges are as equal as they can be from the first on. Raises InputError where a rank would get none.
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


def _furthest(before: Array, limit: float) -> IntArray:
    """Return where a range that begins at each subdomain ends at the latest, (n_subdomains,)."""
    ends = np.searchsorted(before, before[:-1] + limit, side="right") - 1
    return np.asarray(np.maximum(ends, np.arange(1, len(before))), dtype=np.int64)


def _smallest_limit(before: Array, low: float, n_ranks: int) -> float:
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


def scatter_subdomains(team: Team, build: Callable[[], tuple[list[Subdomain], Array]]) -> list[Subdomain]:
    """Build all subdomains on rank 0 and give each rank its own, in their order; collective.

    ``build`` runs on rank 0 alone and returns all subdomains and the work of each, (n_subdomains,). Raises InputError
    on all ranks where there are fewer subdomains than ranks; and what ``build`` raises.
    """
    def share() -> list[list[Subdomain]]:
        subdomains, costs = build()
        return [[subdomains[s] for s in part] for part in split_evenly(costs, team.size)]

    return team.scatter_from_root(share)


T = TypeVar("T")

_STREAM = 3
"""Tag that keeps a stream's items apart from what a team sends otherwise."""


def stream_to_root(team: Team, items: Iterator[T], take: Callable[[T], object]) -> None:
    """Bring all ranks' items, each made when it is asked for, to rank 0 one at a time; collective.

    ``take`` is called on rank 0 alone, with its own items, then with those of the others in the order of ranks. What
    the lowest rank that fails raises while it makes or takes an item is raised on all ranks.
    """
    error: Exception | None = None
    try:
        for item in items:
            if team.is_root:
                take(item)
            else:
                team.finish_sends([team.begin_send([item], 0, _STREAM)])
    except Exception as caught:
        error = caught
    if team.is_root:
        error = _take_streams(team, take, error)
    else:
        # An empty message ends a rank's stream.
        team.finish_sends([team.begin_send([], 0, _STREAM)])
    team.share_error(error)


def _take_streams(team: Team, take: Callable[[T], object], error: Exception | None) -> Exception | None:
    """Take what the other ranks send; after an error it is received all the same, for they wait for that."""
    for rank in range(1, team.size):
        while message := team.receive(rank, _STREAM):
            if error is None:
                try:
                    take(message[0])
                except Exception as caught:
                    error = caught
    return error


def sum_shared_nodes(team: Team, subdomains: Sequence[Subdomain], sums: Sequence[Array]) -> list[Array]:
    """Sum values at nodes, (n_nodes, k) of each owned subdomain, over all subdomains that have them; collective.

    A node's values go to one rank, which adds them up in the order of subdomains and sends the sum back: only ranks
    that share nodes, and those that add up for them, exchange anything. ``sums`` are left as they are; the result is
    equal to the last bit on all subdomains however they are spread over ranks.
    """
    shared = [np.flatnonzero(subdomain.node_multiplicity > 1) for subdomain in subdomains]
    # A rank always has a subdomain.
    nodes = np.concatenate([s.node_ids[places] for s, places in zip(subdomains, shared, strict=True)])
    values = np.concatenate([of_subdomain[places] for of_subdomain, places in zip(sums, shared, strict=True)])
    ends = np.cumsum([len(places) for places in shared])[:-1]
    result = []
    # Copies come in the order of subdomains.
    total = share_among_copies(team, nodes, values, _add_up)
    for of_subdomain, places, added in zip(sums, shared, np.split(total, ends), strict=True):
        whole = of_subdomain.copy()
        whole[places] = added
        result.append(whole)
    return result


def _add_up(nodes: IntArray, values: Array) -> Array:
    """Sum the copies' values of each node, (n, k)."""
    number = np.unique(nodes, return_inverse=True)[1]
    added = np.zeros_like(values)
    # One after the other, as no other sum of numpy promises.
    np.add.at(added, number, values)
    return np.asarray(added[number])


GATHERED = 2**8
"""Values of all ranks that each of them may hold. A larger number takes less time on few ranks, more on many."""

N_INTERVALS = 1024
"""Intervals in which the weight of more values than that is counted at once: what ranks send, 16 kB."""


def find_quantile_of_all(team: Team, values: Array, weights: Array, share: float = 0.5) -> float | None:
    """Find the value below which lies a share of the weight of all ranks' values; None without weight; collective.

    Of many values ranks agree on the interval that holds it, and within that on another one, until few are left. Whole
    numbers as ``weights`` give the same value on any number of ranks; values are finite, both are (n,).
    """
    total, n_left = team.sum(np.array([weights.sum(), len(values)]))
    if total == 0:
        return None
    left = share * total
    while n_left > GATHERED:
        low = -team.maximum(-float(values.min(initial=np.inf)))
        high = team.maximum(float(values.max(initial=-np.inf)))
        if low == high:
            return low
        edges = np.linspace(low, high, N_INTERVALS + 1)[1:-1]
        interval = np.searchsorted(edges, values, side="right")
        mine = [np.bincount(interval, counted, minlength=N_INTERVALS) for counted in (weights, np.ones(len(values)))]
        weight_of, n_in = team.sum(np.array(mine, dtype=np.float64))
        below = np.cumsum(weight_of)
        chosen = int(np.searchsorted(below, left))
        left -= below[chosen - 1] if chosen else 0.0
        n_left = n_in[chosen]
        is_inside = interval == chosen
        values, weights = values[is_inside], weights[is_inside]
    gathered = team.gather_lists([(values, weights)])
    all_values, all_weights = (np.concatenate(arrays) for arrays in zip(*gathered, strict=True))
    return find_value_at(all_values, all_weights, left)


@dataclass(frozen=True)
class TeamSums(BandSums):
    """Each rank owns some bands that follow each other; every call is collective.

    Attributes
    ----------
    team : Team
        All ranks.
    first : int
        Number of this rank's first band.
    """

    team: Team
    first: int

    def add_up(self, of_bands: Iterable[Array]) -> Array:
        """Sum arrays of one shape; only sums of groups of bands are sent."""
        return self.team.sum_numbered(self.first, of_bands)

    def join(self, of_bands: Iterable[Array]) -> Array:
        """Put arrays side by side along their last axis."""
        return np.concatenate(self.team.gather_lists(of_bands), axis=-1)

    def broadcast(self, item: T) -> T:
        """Give all ranks what rank 0 has."""
        return self.team.broadcast(item)

    def together(self, work: Callable[[], T]) -> T:
        """Run work on every rank; an error of one is raised on all."""
        return self.team.together(work)
