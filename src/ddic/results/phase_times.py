"""Seconds by phase over all ranks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team


@dataclass(frozen=True)
class PhaseTimes:
    """Seconds by phase, in the order in which phases began.

    Attributes
    ----------
    seconds : dict
        Wall seconds of the slowest rank.
    cpu_seconds : dict
        CPU seconds of all ranks.
    imbalance : dict
        Busy seconds of the busiest rank over their mean, from 1 (all have the same to do) to the number of ranks (one
        does it all). Busy are CPU seconds that are not spent in a team's communication; what a rank waits inside PETSc
        counts as busy.
    """

    seconds: dict[Phase, float]
    cpu_seconds: dict[Phase, float]
    imbalance: dict[Phase, float]


def gather_phase_times(team: Team, clock: PhaseClock) -> PhaseTimes:
    """Gather what the clocks of all ranks have so far; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    clock : PhaseClock
        This rank's.

    Returns
    -------
    PhaseTimes
        The same on all ranks, of the phases that this rank has had.
    """
    clocks = team.gather_lists([(clock.wall, clock.cpu, clock.busy)])
    seconds, cpu_seconds, imbalance = {}, {}, {}
    for phase in clock.wall:
        seconds[phase] = max(wall.get(phase, 0.0) for wall, _, _ in clocks)
        cpu_seconds[phase] = sum(cpu.get(phase, 0.0) for _, cpu, _ in clocks)
        imbalance[phase] = _imbalance([busy.get(phase, 0.0) for _, _, busy in clocks])
    return PhaseTimes(seconds, cpu_seconds, imbalance)


def _imbalance(busy: list[float]) -> float:
    """Return the largest of the ranks' seconds over their mean, 1 where none has any."""
    mean = float(np.mean(busy))
    return max(busy) / mean if mean > 0 else 1.0
