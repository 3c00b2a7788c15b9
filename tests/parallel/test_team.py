"""Shared decisions, shared errors and sums in a fixed order."""

from __future__ import annotations

from typing import NoReturn

import numpy as np
import pytest
from mpi4py import MPI

from ddic.errors import InputError, SingularSubdomainError, is_collective
from ddic.parallel.distribution import split_evenly
from ddic.parallel.team import Team, require_held

RANKS = [1, 2, 3, 4]


@pytest.fixture
def team() -> Team:
    return Team(MPI.COMM_WORLD)


def _fail(error: Exception) -> NoReturn:
    raise error


class NotPicklable(Exception):
    """Its copy cannot be made: __init__ asks for more than it passes on."""

    def __init__(self, first: str, second: str) -> None:
        super().__init__(first)
        self.second = second


@pytest.mark.parallel(RANKS)
def test_only_the_root_works_and_all_ranks_get_its_result(team: Team) -> None:
    ran: list[int] = []
    value = team.on_root(lambda: ran.append(team.rank) or {"rank": team.rank})
    assert value == {"rank": 0}
    assert ran == ([0] if team.rank == 0 else [])
    assert team.is_root == (team.rank == 0)


@pytest.mark.parallel(RANKS)
def test_the_root_keeps_what_it_gives_and_the_others_get_copies(team: Team) -> None:
    item = np.arange(3)
    given = team.on_root(lambda: item)
    assert (given is item) == team.is_root
    np.testing.assert_array_equal(given, np.arange(3))


@pytest.mark.parallel(RANKS)
def test_an_error_on_the_root_is_raised_on_all_ranks(team: Team) -> None:
    with pytest.raises(InputError, match="first") as caught:
        team.on_root(lambda: _fail(InputError(["first", "second"])))
    assert is_collective(caught.value)
    assert caught.value.problems == ("first", "second")


@pytest.mark.parallel(RANKS)
def test_scatter_gives_each_rank_its_item(team: Team) -> None:
    assert team.scatter_from_root(lambda: [10 * rank for rank in range(team.size)]) == 10 * team.rank
    with pytest.raises(InputError) as caught:
        team.scatter_from_root(lambda: _fail(InputError("nothing to give")))
    assert is_collective(caught.value)


@pytest.mark.parallel(RANKS)
def test_together_returns_each_ranks_own(team: Team) -> None:
    assert team.together(lambda: team.rank) == team.rank


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("failing", range(4))
def test_an_error_on_one_rank_is_raised_on_all(team: Team, failing: int) -> None:
    failing %= team.size

    def work() -> None:
        if team.rank == failing:
            raise SingularSubdomainError(f"rank {failing} has no texture")

    with pytest.raises(SingularSubdomainError, match=f"rank {failing} has no texture") as caught:
        team.together(work)
    assert is_collective(caught.value)
    # The ranks are still in step.
    assert team.comm.allreduce(1) == team.size


@pytest.mark.parallel(RANKS)
def test_of_several_errors_the_lowest_ranks_is_told(team: Team) -> None:
    with pytest.raises(InputError, match="from rank 0"):
        team.together(lambda: _fail(InputError(f"from rank {team.rank}")))


@pytest.mark.parallel(RANKS)
def test_an_unexpected_error_brings_the_traceback_of_its_rank(team: Team) -> None:
    last = team.size - 1

    def deep_inside() -> None:
        if team.rank == last:
            raise ZeroDivisionError("on one rank")

    with pytest.raises(ZeroDivisionError, match="on one rank") as caught:
        team.together(deep_inside)
    assert f"rank {last}" in "".join(caught.value.__notes__)
    assert "in deep_inside" in "".join(caught.value.__notes__)


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("operation", ["on_root", "together", "scatter_from_root"])
def test_an_error_that_cannot_travel_is_still_raised_on_all_ranks(team: Team, operation: str) -> None:
    with pytest.raises(RuntimeError, match="NotPicklable: the reason") as caught:
        getattr(team, operation)(lambda: _fail(NotPicklable("the reason", "lost")))
    assert is_collective(caught.value)


@pytest.mark.parallel(RANKS)
def test_ordered_sum_is_the_same_to_the_last_bit_however_subdomains_are_spread(team: Team) -> None:
    # Terms of very different sizes: any other order of the sum would round differently.
    rng = np.random.default_rng(0)
    terms = [rng.normal(size=3) * 10.0 ** rng.integers(-8, 8) for _ in range(11)]
    mine = [terms[s] for s in split_evenly(np.ones(11), team.size)[team.rank]]
    total = team.ordered_sum(mine)
    alone = Team(MPI.COMM_SELF).ordered_sum(terms)
    np.testing.assert_array_equal(total, alone)
    # At most 11 roundings of the largest partial sum.
    np.testing.assert_allclose(total, np.sum(terms, axis=0), rtol=0, atol=1e-14 * np.abs(terms).sum())


@pytest.mark.parallel(RANKS)
def test_lists_are_gathered_in_the_order_of_ranks(team: Team) -> None:
    mine = [(team.rank, k) for k in range(team.rank + 1)]
    assert team.gather_lists(mine) == [(rank, k) for rank in range(team.size) for k in range(rank + 1)]


@pytest.mark.parallel(RANKS)
def test_what_the_root_sends_is_the_other_ranks_alone(team: Team) -> None:
    for to in range(team.size):
        found = team.send_from_root({"to": to} if team.is_root else None, to)
        assert found == ({"to": to} if team.rank == to else None)


@pytest.mark.parallel(RANKS)
def test_what_is_built_on_the_root_stays_there_and_its_error_does_not(team: Team) -> None:
    built = team.build_on_root(lambda: "a large thing")
    assert built == ("a large thing" if team.is_root else None)
    assert team.on_root(lambda: require_held(built).upper()) == "A LARGE THING"
    with pytest.raises(InputError, match="no thing") as caught:
        team.build_on_root(lambda: _fail(InputError("no thing")))
    assert is_collective(caught.value)


def test_a_rank_that_holds_nothing_is_told_so() -> None:
    assert require_held(0) == 0
    with pytest.raises(RuntimeError, match="holds nothing"):
        require_held(None)


@pytest.mark.parallel(RANKS)
def test_items_go_to_one_rank_and_from_one_rank(team: Team) -> None:
    last = team.size - 1
    gathered = team.gather_to(10 * team.rank, last)
    assert gathered == ([10 * rank for rank in range(team.size)] if team.rank == last else None)
    assert team.broadcast("the last rank's" if team.rank == last else None, last) == "the last rank's"


@pytest.mark.parallel(RANKS)
def test_exchanges_reach_those_they_are_for_and_no_others(team: Team) -> None:
    # Every rank to the next one and to rank 0; twice in a row, for items of two exchanges must not mix.
    for turn in range(2):
        to = {(team.rank + 1) % team.size, 0}
        received = team.exchange({rank: (turn, team.rank, rank) for rank in to})
        sources = {(team.rank - 1) % team.size} if team.rank else set(range(team.size))
        assert received == {source: (turn, source, team.rank) for source in sources}
        assert list(received) == sorted(received)
    assert team.exchange({}) == {}


@pytest.mark.parallel(RANKS)
def test_sums_largest_and_offsets_over_ranks(team: Team) -> None:
    assert team.sum(team.rank + 1) == team.size * (team.size + 1) // 2
    assert team.maximum(float(team.rank)) == team.size - 1
    # Of equal first entries the largest second one.
    assert team.maximum((1.5, team.rank)) == (1.5, team.size - 1)
    assert team.offset(team.rank + 2) == sum(rank + 2 for rank in range(team.rank))
    np.testing.assert_array_equal(team.sum_below(np.array([1, team.rank])), [team.rank, sum(range(team.rank))])
    # Neither in C's order nor contiguous.
    mine = np.arange(12.0).reshape(4, 3).T[:, ::2] + team.rank
    first = np.arange(12.0).reshape(4, 3).T[:, ::2]
    np.testing.assert_array_equal(team.sum(mine), team.size * first + sum(range(team.size)))
    np.testing.assert_array_equal(team.maximum(mine), first + team.size - 1)


@pytest.mark.parallel(RANKS)
def test_sends_that_were_begun_arrive_in_their_order(team: Team) -> None:
    to, source = (team.rank + 1) % team.size, (team.rank - 1) % team.size
    requests = [team.begin_send((team.rank, k), to) for k in range(3)]
    assert [team.receive(source) for _ in range(3)] == [(source, k) for k in range(3)]
    team.finish_sends(requests)


@pytest.mark.parallel(RANKS)
def test_ranks_of_a_node_are_a_team_whose_waiting_counts(team: Team) -> None:
    with team.of_this_node() as node:
        assert node.gather_lists([team.rank]) == list(range(team.size))
        assert node.waiting is team.waiting
    assert node.comm == MPI.COMM_NULL
