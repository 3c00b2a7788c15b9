"""Seconds by phase."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from ddic.parallel.team import Waiting


@dataclass
class PhaseClock:
    """Adds up wall and CPU seconds by phase; each layer is handed the clock it writes to.

    wall, cpu, busy: seconds by phase name, busy being CPU seconds without those that ``waiting`` counts;
    entered: told the name of each phase that begins.
    """

    wall: dict[str, float] = field(default_factory=dict)
    cpu: dict[str, float] = field(default_factory=dict)
    busy: dict[str, float] = field(default_factory=dict)
    entered: Callable[[str], None] | None = None
    waiting: Waiting = field(default_factory=Waiting)

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Charge the time spent inside to ``name``."""
        if self.entered is not None:
            self.entered(name)
        wall, cpu, waited = time.perf_counter(), time.process_time(), self.waiting.seconds
        try:
            yield
        finally:
            spent = time.process_time() - cpu
            self.wall[name] = self.wall.get(name, 0.0) + time.perf_counter() - wall
            self.cpu[name] = self.cpu.get(name, 0.0) + spent
            self.busy[name] = self.busy.get(name, 0.0) + spent - (self.waiting.seconds - waited)
