"""Items of all ranks brought to rank 0 one by one, so that it never holds all of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, TypeVar

from ddic.parallel.team import Team

T = TypeVar("T")

_STREAM = 3
"""Tag that keeps a stream's items apart from what a team sends otherwise."""


def stream_to_root(team: Team, items: Iterator[T], take: Callable[[T], object]) -> None:
    """Bring all ranks' items to rank 0 one at a time; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    items : iterator
        This rank's, each made when it is asked for.
    take : callable
        Called on rank 0 alone, with its own items, then with those of the others in the order of ranks.

    Raises
    ------
    Exception
        What the lowest rank that fails raises while it makes or takes an item, on all ranks.
    """
    error: Exception | None = None
    try:
        for item in items:
            if team.is_root:
                take(item)
            else:
                _send(team, [item])
    except Exception as caught:
        error = caught
    if team.is_root:
        error = _take_streams(team, take, error)
    else:
        # An empty message ends a rank's stream.
        _send(team, [])
    team.share_error(error)


def _take_streams(team: Team, take: Callable[[T], object], error: Exception | None) -> Exception | None:
    """Take what the other ranks send; after an error it is received all the same, for they wait for that."""
    for rank in range(1, team.size):
        while message := _receive(team, rank):
            if error is None:
                try:
                    take(message[0])
                except Exception as caught:
                    error = caught
    return error


def _send(team: Team, message: list[T]) -> None:
    with team.waiting.counted():
        team.waiting.wait_until(team.comm.isend(message, dest=0, tag=_STREAM).Test)


def _receive(team: Team, rank: int) -> list[Any]:
    with team.waiting.counted():
        message: list[Any] = team.receive_message(rank, _STREAM)
    return message
