"""What a rank spends on waiting for others."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass
class Waiting:
    """CPU seconds that this rank has spent in a team's communication: MPI turns in a loop while it waits.

    Attributes
    ----------
    seconds : float
        So far.
    """

    seconds: float = 0.0

    @contextmanager
    def counted(self) -> Iterator[None]:
        """Count the time spent inside."""
        began = time.process_time()
        try:
            yield
        finally:
            self.seconds += time.process_time() - began
