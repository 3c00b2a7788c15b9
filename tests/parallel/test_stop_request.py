"""A signal to one rank is a request that all ranks know of."""

from __future__ import annotations

import os
import signal
from dataclasses import replace

import pytest
from mpi4py import MPI

from ddic.errors import ConvergenceError, StoppedError, is_collective
from ddic.parallel import stop_request
from ddic.parallel.stop_request import REPEATED_AFTER, StopRequest, is_stop_asked, stop_if_asked
from ddic.parallel.team import Team


@pytest.mark.parallel([1, 2, 3])
def test_what_one_rank_is_asked_all_know() -> None:
    last = MPI.COMM_WORLD.size - 1
    team = replace(Team.world(), stop=StopRequest())
    assert not is_stop_asked(team)
    stop_if_asked(team, "at once")
    team.stop.asked = team.rank == last
    assert is_stop_asked(team)
    with pytest.raises(StoppedError, match="stopped by a signal after iteration 3") as caught:
        stop_if_asked(team, "after iteration 3")
    assert is_collective(caught.value)
    # Which is what lets the last field be kept.
    assert isinstance(caught.value, ConvergenceError)


@pytest.mark.parallel([1, 2])
def test_the_ranks_of_a_node_are_asked_with_the_others() -> None:
    team = Team.world()
    with team.of_this_node() as node:
        assert node.stop is team.stop


@pytest.fixture
def interrupted(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Signals that would reach the main thread."""
    numbers: list[int] = []
    monkeypatch.setattr(signal, "pthread_kill", lambda thread, number: numbers.append(number))
    return numbers


@pytest.mark.parametrize("number", stop_request.STOPPING)
def test_a_first_signal_asks_and_nothing_else(interrupted: list[int], number: signal.Signals) -> None:
    request = StopRequest()
    request.note(number, os.getppid())
    assert request.asked
    assert interrupted == []


def test_only_a_later_sigterm_ends_at_once(interrupted: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr(stop_request.time, "monotonic", lambda: now)
    request = StopRequest()
    request.note(signal.SIGUSR1, 0)
    now += 2 * REPEATED_AFTER
    request.note(signal.SIGTERM, 0)
    now += 0.1 * REPEATED_AFTER
    request.note(signal.SIGTERM, 0)
    now += 2 * REPEATED_AFTER
    request.note(signal.SIGUSR1, 0)
    assert interrupted == []
    request.note(signal.SIGTERM, 0)
    assert interrupted == [signal.SIGALRM]


def test_a_launcher_that_ends_is_obeyed_at_once(interrupted: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stop_request, "_is_launcher", lambda process: process == 7)
    request = StopRequest()
    request.note(signal.SIGTERM, 8)
    assert interrupted == []
    request.note(signal.SIGTERM, 7)
    assert interrupted == [signal.SIGALRM]
