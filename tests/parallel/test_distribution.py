"""Subdomains spread over ranks."""

from __future__ import annotations

from dataclasses import fields
from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import sparse

from ddic.errors import InputError, is_collective
from ddic.kinematics.kinematics import RegionKinematics
from ddic.kinematics.linear import LinearRegion
from ddic.parallel.distribution import scatter_subdomains, split_evenly
from ddic.parallel.team import Team
from ddic.partition import sharing
from ddic.partition.sharing import build_subdomains, cut_subdomains, number_interfaces
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


@pytest.mark.parallel([1, 2, 3, 4])
@pytest.mark.parametrize("kind", ["nodes", "modes"])
def test_subdomains_are_connected_on_any_number_of_ranks_as_on_one(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # Several blocks of numbers for each rank.
    monkeypatch.setattr(sharing, "BLOCK", 16)
    team = Team.world()
    problem = linear_step()
    region: RegionKinematics = problem.region
    if kind == "modes":
        # Two more unknowns, which are no edge's but every subdomain's.
        modes = np.random.default_rng(1).normal(size=(problem.mesh.n_dofs, 2))
        region = LinearRegion(problem.mesh, sparse.hstack([sparse.identity(problem.mesh.n_dofs), modes]).tocsr())
    parts = split(problem.mesh, "metis", 9)
    controlled = np.random.default_rng(0).random(region.n_unknowns) < 0.7
    everything = build_subdomains(region, parts, controlled)
    inside = np.ones(problem.mesh.n_nodes, dtype=bool)
    unconnected = cut_subdomains(region, parts, controlled, inside)
    mine = [unconnected[s] for s in split_evenly(np.ones(9), team.size)[team.rank]]
    for found in number_interfaces(mine, [s.controlled for s in mine], team):
        expected = everything[found.index]
        for name in ("node_multiplicity", "multiplicity", "n_owned_rows", "n_owned_copies"):
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)
        for one, other in ((found.jumps, expected.jumps), (found.reactions, expected.reactions)):
            for field in fields(one):
                np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name), err_msg=field.name)


@pytest.mark.parallel([2, 3, 4])
def test_too_few_subdomains_are_an_error_on_all_ranks() -> None:
    team = Team.world()
    problem = linear_step()
    whole = np.zeros(problem.mesh.n_cells, dtype=np.int64)
    with pytest.raises(InputError, match="MPI ranks for 1 subdomains") as caught:
        scatter_subdomains(team, lambda: (build_subdomains(problem.region, whole, problem.controlled), np.ones(1)))
    assert is_collective(caught.value)
