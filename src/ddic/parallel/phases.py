"""Seconds by phase."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TypeVar

from ddic.parallel.team import Waiting

T = TypeVar("T")


class Phase(StrEnum):
    """The phases of a run in their order, by the name that the progress bar, the summary and the result file give."""

    MESH = "mesh"
    START = "start"
    READ = "read"
    ASSEMBLE = "assemble"
    INDEPENDENT_START = "independent start"
    FACTORIZE = "factorize"
    INTERFACE_SET_UP = "interface set-up"
    RESIDUAL = "residual"
    LINEAR_STEP = "linear step"
    FINISH = "finish"
    WRITE = "write"


REPEATED = (Phase.RESIDUAL, Phase.LINEAR_STEP)
"""Phases that every iteration of Gauss-Newton has."""


@dataclass
class PhaseClock:
    """Adds up wall and CPU seconds by phase; each layer is given the clock that it writes to.

    Attributes
    ----------
    wall, cpu : dict
        Seconds by phase, in the order in which phases began.
    busy : dict
        CPU seconds by phase without those that ``waiting`` counts.
    entered : callable or None
        Told each phase that begins.
    advanced : callable or None
        Told which share of the phase at hand this rank has done, from 0 to 1.
    waiting : Waiting
        Of the team whose communication is no work; by default nothing counts as waiting.
    """

    wall: dict[Phase, float] = field(default_factory=dict)
    cpu: dict[Phase, float] = field(default_factory=dict)
    busy: dict[Phase, float] = field(default_factory=dict)
    entered: Callable[[Phase], None] | None = None
    advanced: Callable[[float], None] | None = None
    waiting: Waiting = field(default_factory=Waiting)

    @contextmanager
    def phase(self, phase: Phase) -> Iterator[None]:
        """Charge the time spent inside to a phase; what was spent in it before counts too."""
        if self.entered is not None:
            self.entered(phase)
        wall_before = time.perf_counter()
        cpu_before = time.process_time()
        waited_before = self.waiting.seconds
        try:
            yield
        finally:
            cpu = time.process_time() - cpu_before
            waited = self.waiting.seconds - waited_before
            self.wall[phase] = self.wall.get(phase, 0.0) + time.perf_counter() - wall_before
            self.cpu[phase] = self.cpu.get(phase, 0.0) + cpu
            self.busy[phase] = self.busy.get(phase, 0.0) + cpu - waited

    def note_each(self, items: Sequence[T], end: float = 1.0) -> Iterator[T]:
        """Go through what the phase at hand works on, and tell how far it is, items alike, up to the share ``end``."""
        for n_done, item in enumerate(items, start=1):
            yield item
            if self.advanced is not None:
                self.advanced(end * n_done / len(items))
