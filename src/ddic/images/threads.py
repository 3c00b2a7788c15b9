"""Threads of one process that share out work on pixels."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from typing import TypeVar

T = TypeVar("T")

SLICES = 4
"""Slices a thread: those of one length take unequal time, so that whoever is done takes another."""


class Threads:
    """A number of threads; with one, work is done by the caller itself.

    The interpreter runs one thread at a time: work must be mostly compiled kernels and copies of arrays, which let go
    of it. What comes of an item must depend neither on the others nor on who works on it; then the number of threads
    changes no digit.

    Parameters
    ----------
    n : int
        Their number; ValueError is raised where it is below 1.
    """

    def __init__(self, n: int = 1) -> None:
        if n < 1:
            raise ValueError(f"{n} threads; at least one is needed")
        self.n = n
        # Kept from call to call: threads that begin anew cost as much as a small subdomain's residual.
        self._pool = ThreadPoolExecutor(n, thread_name_prefix="ddic-pixels") if n > 1 else None

    def share(self, items: Iterable[T], work: Callable[[Iterator[T]], None]) -> None:
        """Call a function on every thread, each item going to one of them, wait for all, and raise what one raised."""
        if self._pool is None:
            work(iter(items))
            return
        # Threads may take from one end of it at once; a generator they may not share.
        waiting = deque(items)
        running = [self._pool.submit(work, _take_from(waiting)) for _ in range(self.n)]
        wait(running)
        for thread in running:
            thread.result()

    def run_over(self, n: int, least: int, work: Callable[[slice], None]) -> None:
        """Call a function on slices that cover a sequence of length n, and wait for all.

        No slice is shorter than ``least`` where the sequence is longer. What it raises is raised once no thread works
        any more.
        """
        n_slices = 1 if self._pool is None else max(1, min(SLICES * self.n, n // least))
        if n_slices == 1:
            work(slice(0, n))
            return
        ends = [n * k // n_slices for k in range(n_slices + 1)]

        def each(slices: Iterator[slice]) -> None:
            for part in slices:
                work(part)

        self.share(map(slice, ends[:-1], ends[1:]), each)


ONE_THREAD = Threads()


def _take_from(waiting: deque[T]) -> Iterator[T]:
    """Take items until none is left."""
    with suppress(IndexError):
        while True:
            yield waiting.popleft()
