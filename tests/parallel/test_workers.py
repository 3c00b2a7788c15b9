"""Ranks that work for one of them."""

from __future__ import annotations

from typing import NoReturn

import pytest
from mpi4py import MPI

from ddic.errors import InputError, is_collective
from ddic.parallel.team import Team
from ddic.parallel.workers import Workers

RANKS = [1, 2, 3, 4]


def _workers() -> Workers[int]:
    team = Team(MPI.COMM_WORLD)
    return Workers(team, team.size - 1, 100 * team.rank)


def _add(held: int, item: int) -> tuple[int, int]:
    return held // 100, held + item


def _refuse_seven(held: int, item: int) -> int:
    return _fail(InputError("seven")) if item == 7 else held


def _fail(error: Exception) -> NoReturn:
    raise error


@pytest.mark.parallel(RANKS)
def test_all_ranks_work_and_one_asks_for_more() -> None:
    workers = _workers()
    team, n = workers.team, 2 * workers.team.size

    def lead() -> list[tuple[int, int]]:
        first = workers.map(_add, range(n))
        # What comes next depends on what was found.
        return [*first, *workers.map(_add, [sum(value for _, value in first)]), *workers.map(_add, [])]

    own, found = workers.run(lead, lambda: team.rank)
    assert own == team.rank
    if team.rank != workers.leader:
        assert found is None
        return
    expected = [(item // 2, 100 * (item // 2) + item) for item in range(n)]
    assert found == [*expected, (0, sum(value for _, value in expected))]


@pytest.mark.parallel(RANKS)
def test_without_a_question_nobody_works() -> None:
    workers = _workers()
    _, found = workers.run(lambda: "found", lambda: None)
    assert found == ("found" if workers.team.rank == workers.leader else None)


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("where", ["leader", "worker", "before"])
def test_an_error_is_raised_on_all_ranks(where: str) -> None:
    workers = _workers()
    before = (lambda: _fail(InputError("seven"))) if where == "before" and workers.team.rank == 0 else (lambda: None)

    def lead() -> None:
        workers.map(_refuse_seven, [7] if where == "worker" else [1])
        if where == "leader":
            _fail(InputError("seven"))

    with pytest.raises(InputError, match="seven") as caught:
        workers.run(lead, before)
    assert is_collective(caught.value)
    # Nobody is left waiting.
    assert workers.team.sum(1) == workers.team.size
