"""Seconds by phase over all ranks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team


@dataclass(frozen=True)
class PhaseTimes:
    """Seconds by phase, in the order in which phases began.

    seconds: wall seconds of the slowest rank; cpu_seconds: of all ranks; imbalance: busy seconds of the busiest rank
    over their mean, from 1 (all have the same to do) to the number of ranks (one does it all). Busy are CPU seconds
    that are not spent in a team's communication; what a rank waits inside PETSc counts as busy.
    """

    seconds: dict[str, float]
    cpu_seconds: dict[str, float]
    imbalance: dict[str, float]


def phase_times(team: Team, clock: PhaseClock) -> PhaseTimes:
    """What the clocks of all ranks have so far; collective."""
    clocks = team.gather_lists([(clock.wall, clock.cpu, clock.busy)])
    names = list(clock.wall)

    def of(kind: int, name: str) -> list[float]:
        return [times[kind].get(name, 0.0) for times in clocks]

    return PhaseTimes({name: max(of(0, name)) for name in names}, {name: sum(of(1, name)) for name in names},
                      {name: _imbalance(of(2, name)) for name in names})


def _imbalance(busy: list[float]) -> float:
    mean = float(np.mean(busy))
    return max(busy) / mean if mean > 0 else 1.0
