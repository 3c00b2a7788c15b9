"""Seconds by phase and their imbalance over ranks."""

from __future__ import annotations

import time

import pytest
from mpi4py import MPI

from ddic.methods.run import gather_phase_times
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team

RANKS = [1, 3]
WORK = 0.15


def _work(seconds: float) -> None:
    """Spend CPU seconds, however busy the machine is."""
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass


@pytest.mark.parallel(RANKS)
def test_a_rank_that_waits_is_not_busy() -> None:
    team = Team(MPI.COMM_WORLD)
    clock = PhaseClock(waiting=team.waiting)
    with clock.phase(Phase.READ):
        team.together(lambda: _work(WORK))
    with clock.phase(Phase.MESH):
        team.on_root(lambda: _work(WORK))
    with clock.phase(Phase.ASSEMBLE):
        team.together(lambda: _work(WORK if team.rank == team.size - 1 else 0.0))
    with clock.phase(Phase.START):
        if team.is_root:
            _work(WORK)
        team.send_from_root("a thing" if team.is_root else None, team.size - 1)
    times = gather_phase_times(team, clock)
    assert team.gather_lists([times]) == [times] * team.size
    assert list(times.seconds) == [Phase.READ, Phase.MESH, Phase.ASSEMBLE, Phase.START]
    # 10 %: what MPI's own work and the clock's steps may add to 0.15 s.
    assert times.imbalance[Phase.READ] <= 1.1
    for name in (Phase.MESH, Phase.ASSEMBLE, Phase.START):
        assert 0.9 * team.size <= times.imbalance[name] <= team.size * (1 + 1e-12)
    assert times.cpu_seconds[Phase.READ] >= team.size * WORK
    assert all(wall >= WORK for wall in times.seconds.values())


@pytest.mark.parallel([2])
def test_a_phase_that_only_one_rank_had_counts_as_nothing_elsewhere() -> None:
    team = Team(MPI.COMM_WORLD)
    clock = PhaseClock(waiting=team.waiting)
    if team.is_root:
        with clock.phase(Phase.FINISH):
            _work(WORK)
    phases = team.broadcast(list(clock.wall))
    for phase in phases:
        with clock.phase(phase):
            pass
    assert gather_phase_times(team, clock).imbalance[Phase.FINISH] == pytest.approx(2.0, rel=0.05)
