"""What a rank spends on waiting for others."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

AWAKE = 2e-4
"""Seconds that a rank looks again and again before it sleeps between two looks. A larger value takes more of the
processor, a smaller one makes ranks that arrive together wait for one another's sleep."""

SLEPT_SHARE = 0.2
"""Time between two looks over that waited so far: by as much a wait may become longer."""

LONGEST_SLEEP = 2e-3
"""Between two looks, seconds. A larger value delays what others send through this rank."""


@dataclass
class Waiting:
    """CPU seconds that this rank has spent in a team's communication.

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

    def wait_until(self, is_done: Callable[[], bool]) -> None:
        """Wait for others, mostly asleep: MPI's own operations turn in a loop, on a processor that others need.

        Parameters
        ----------
        is_done : callable
            ``Test`` of an operation that was begun, or the like.
        """
        began = time.perf_counter()
        while not is_done():
            waited = time.perf_counter() - began
            if waited > AWAKE:
                time.sleep(min(SLEPT_SHARE * waited, LONGEST_SLEEP))
