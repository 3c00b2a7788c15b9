"""A signal to one rank is a request that all ranks know of."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import NoReturn

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


class _EndedError(Exception):
    """Stands for the end of the process."""


def _end(line: str, code: int, head_start: float) -> NoReturn:
    raise _EndedError(line, code)


@pytest.fixture
def interrupted(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Signals that would reach the main thread; the process would end by _EndedError."""
    numbers: list[int] = []
    monkeypatch.setattr(signal, "pthread_kill", lambda thread, number: numbers.append(number))
    monkeypatch.setattr(stop_request, "abort_all_ranks", _end)
    monkeypatch.setattr(stop_request, "BETWEEN", 0.0)
    # Interruptions are sent by a thread; what ends it here ends no process.
    monkeypatch.setattr(stop_request.threading, "Thread", _AtOnce)
    return numbers


class _AtOnce:
    """A thread that does its work when it is started."""

    def __init__(self, target: Callable[[], None], **options: object) -> None:
        self._target = target

    def start(self) -> None:
        self._target()


def _begun() -> StopRequest:
    return StopRequest(has_begun=True)


@pytest.mark.parametrize("number", stop_request.STOPPING)
def test_a_first_signal_asks_and_nothing_else(interrupted: list[int], number: signal.Signals) -> None:
    request = _begun()
    request.note(number, os.getppid())
    assert request.asked
    assert interrupted == []


@pytest.mark.parametrize(("number", "code"), [
    *((number, 3) for number in stop_request.STOPPING), *((number, 130) for number in stop_request.ENDING)])
def test_a_signal_before_the_beginning_ends_the_process(interrupted: list[int], number: signal.Signals,
                                                        code: int) -> None:
    with pytest.raises(_EndedError) as caught:
        StopRequest().note(number, os.getppid())
    assert caught.value.args[1] == code
    assert interrupted == []


@pytest.mark.parametrize("number", stop_request.ENDING)
def test_the_main_thread_is_interrupted_until_it_ends(interrupted: list[int], number: signal.Signals,
                                                      monkeypatch: pytest.MonkeyPatch) -> None:
    # A library has caught each interruption, or never returns.
    with pytest.raises(_EndedError, match="interrupted; no result was written"):
        _begun().note(number, 0)
    assert interrupted == [signal.SIGALRM] * stop_request.N_INTERRUPTIONS
    request = _begun()
    monkeypatch.setattr(signal, "pthread_kill", lambda thread, number: setattr(request, "is_over", True))
    request.note(number, 0)
    request.note(number, 0)
    assert request.is_over


def test_a_second_interruption_ends_at_once(interrupted: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr(stop_request.time, "monotonic", lambda: now)
    monkeypatch.setattr(StopRequest, "_interrupt_until_over", lambda request: interrupted.append(0))
    request = _begun()
    request.note(signal.SIGINT, 0)
    now += 0.5 * REPEATED_AFTER
    request.note(signal.SIGINT, 0)  # the first one again
    assert interrupted == [0]
    now += REPEATED_AFTER
    with pytest.raises(_EndedError):
        request.note(signal.SIGINT, 0)


def test_only_a_later_sigterm_ends_at_once(interrupted: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr(stop_request.time, "monotonic", lambda: now)
    monkeypatch.setattr(StopRequest, "_interrupt_until_over", lambda request: interrupted.append(0))
    request = _begun()
    request.note(signal.SIGUSR1, 0)
    now += 2 * REPEATED_AFTER
    request.note(signal.SIGTERM, 0)
    now += 0.1 * REPEATED_AFTER
    request.note(signal.SIGTERM, 0)
    now += 2 * REPEATED_AFTER
    request.note(signal.SIGUSR1, 0)
    # It comes every second once the time of the processor is used up.
    request.note(signal.SIGXCPU, 0)
    assert interrupted == []
    request.note(signal.SIGTERM, 0)
    assert interrupted == [0]


def test_a_launcher_that_ends_is_obeyed_at_once(interrupted: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stop_request, "is_launcher", lambda process: process == 7)
    monkeypatch.setattr(StopRequest, "_interrupt_until_over", lambda request: interrupted.append(0))
    request = _begun()
    request.note(signal.SIGTERM, 8)
    assert interrupted == []
    assert not request.is_by_launcher
    request.note(signal.SIGTERM, 7)
    assert interrupted == [0]
    assert request.is_by_launcher


def test_an_interruption_that_a_finalizer_swallows_comes_again(monkeypatch: pytest.MonkeyPatch,
                                                               capsys: pytest.CaptureFixture[str]) -> None:
    again: list[int] = []
    monkeypatch.setattr(stop_request, "_interrupt_main_thread", lambda: again.append(1))
    monkeypatch.setattr(stop_request.threading, "Timer", lambda seconds, work: _AtOnce(work))
    request = _begun()
    monkeypatch.setattr(sys, "unraisablehook", request._take_up)
    _lose(KeyboardInterrupt())
    assert again == [1]
    request.is_over = True
    _lose(KeyboardInterrupt())
    assert again == [1]
    assert capsys.readouterr().err == ""
    _lose(ValueError("of a finalizer"))
    assert "of a finalizer" in capsys.readouterr().err


def _lose(error: BaseException) -> None:
    """Raise an error where nothing can catch it."""
    class Lost:
        def __del__(self) -> None:
            raise error

    Lost()
