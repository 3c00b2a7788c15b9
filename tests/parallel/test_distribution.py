"""Subdomains spread over ranks."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ddic.errors import InputError, is_collective
from ddic.parallel.distribution import scatter_subdomains, split_evenly
from ddic.parallel.team import Team
from ddic.partition.build_subdomains import build_subdomains
from support.linear import linear_step, split

RANKS = [1, 2, 3, 4]


@given(n_ranks=st.integers(1, 40), more=st.integers(0, 100))
def test_equal_costs_give_equal_numbers(n_ranks: int, more: int) -> None:
    ranges = split_evenly(np.ones(n_ranks + more), n_ranks)
    assert [s for part in ranges for s in part] == list(range(n_ranks + more))
    sizes = [len(part) for part in ranges]
    assert len(sizes) == n_ranks
    assert min(sizes) >= 1
    assert max(sizes) - min(sizes) <= 1


@given(costs=st.lists(st.one_of(st.just(0.0), st.floats(0.01, 100.0)), min_size=1, max_size=9), data=st.data())
def test_no_contiguous_ranges_have_a_smaller_largest_cost(costs: list[float], data: st.DataObject) -> None:
    n_ranks = data.draw(st.integers(1, len(costs)))
    ranges = split_evenly(np.array(costs), n_ranks)
    assert [s for part in ranges for s in part] == list(range(len(costs)))
    assert len(ranges) == n_ranks
    assert all(len(part) >= 1 for part in ranges)
    best = min(max(sum(costs[a:b]) for a, b in pairwise((0, *cuts, len(costs))))
               for cuts in combinations(range(1, len(costs)), n_ranks - 1))
    # Sums of at most nine numbers in another order.
    assert max(sum(costs[s] for s in part) for part in ranges) <= best * (1 + 1e-12)


def test_ranges_are_equal_within_the_least_possible_largest_cost() -> None:
    # The first subdomain alone sets the limit of 10; the others could go to one rank and do not.
    assert [list(part) for part in split_evenly(np.array([10.0, 2, 2, 2, 2]), 3)] == [[0], [1, 2], [3, 4]]


def test_the_least_largest_cost_comes_before_equal_ranges() -> None:
    # Ranges that end nearest to their share of what is left would be [2, 8], [7], [2], [8], with 10 instead of 9.
    assert [list(part) for part in split_evenly(np.array([2.0, 8, 7, 2, 8]), 4)] == [[0], [1], [2, 3], [4]]


def test_more_ranks_than_subdomains_are_refused() -> None:
    with pytest.raises(InputError, match=r"5 MPI ranks for 4 subdomains.*at most 4.*solver\.subdomains"):
        split_evenly(np.ones(4), 5)


@pytest.mark.parallel(RANKS)
def test_every_rank_gets_its_own_subdomains_whole() -> None:
    team = Team.world()
    problem = linear_step(wavelength=32.0)
    everything = build_subdomains(problem.region, split(problem.mesh, "metis", 9), problem.controlled)
    costs = np.array([5.0, 1, 1, 1, 1, 1, 1, 1, 5])
    mine = scatter_subdomains(team, lambda: (everything, costs))
    assert [s.index for s in mine] == list(split_evenly(costs, team.size)[team.rank])
    for s in mine:
        np.testing.assert_array_equal(s.node_ids, everything[s.index].node_ids)
        np.testing.assert_array_equal(s.mesh.nodes, everything[s.index].mesh.nodes)
        np.testing.assert_array_equal(s.reactions.first_row, everything[s.index].reactions.first_row)


@pytest.mark.parallel([2, 3, 4])
def test_too_few_subdomains_are_an_error_on_all_ranks() -> None:
    team = Team.world()
    problem = linear_step()
    whole = np.zeros(problem.mesh.n_cells, dtype=np.int64)
    with pytest.raises(InputError, match="MPI ranks for 1 subdomains") as caught:
        scatter_subdomains(team, lambda: (build_subdomains(problem.region, whole, problem.controlled), np.ones(1)))
    assert is_collective(caught.value)
