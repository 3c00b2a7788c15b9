"""Items of all ranks, brought to rank 0 one by one."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from mpi4py import MPI

from ddic.errors import InputError, is_collective
from ddic.parallel.distribution import stream_to_root
from ddic.parallel.team import Team

RANKS = [1, 2, 3, 4]


@pytest.fixture
def team() -> Team:
    return Team(MPI.COMM_WORLD)


@pytest.mark.parallel(RANKS)
def test_root_takes_a_stream_item_by_item_in_the_order_of_ranks(team: Team) -> None:
    made = []

    def items() -> Iterator[tuple[int, int]]:
        # The second rank has none.
        for k in range(0 if team.rank == 1 else 3):
            made.append(k)
            yield team.rank, k

    taken = []

    def take(item: tuple[int, int]) -> None:
        taken.append(item)
        # The next is made when this one has been taken.
        assert made == [k for rank, k in taken if rank == 0]

    stream_to_root(team, items(), take)
    if team.is_root:
        assert taken == [(rank, k) for rank in range(team.size) for k in range(0 if rank == 1 else 3)]
    else:
        assert len(made) == (0 if team.rank == 1 else 3)
        assert taken == []


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("failing", ["first", "own last", "last rank", "source"])
def test_an_error_in_a_stream_is_raised_on_all_ranks(team: Team, failing: str) -> None:
    last = team.size - 1

    def items() -> Iterator[tuple[int, int]]:
        for k in range(3):
            if failing == "source" and (team.rank, k) == (last, 1):
                raise InputError("no more")
            yield team.rank, k

    refused = {"first": (0, 0), "own last": (0, 2), "last rank": (last, 1)}

    def take(item: tuple[int, int]) -> None:
        if item == refused.get(failing):
            raise InputError("no more")

    with pytest.raises(InputError, match="no more") as caught:
        stream_to_root(team, items(), take)
    assert is_collective(caught.value)
    # Nothing of the stream is left to be received.
    taken: list[int] = []
    stream_to_root(team, iter([team.rank]), taken.append)
    assert taken == (list(range(team.size)) if team.is_root else [])
