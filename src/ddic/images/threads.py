"""Threads of one process that share out work on pixels."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from threading import Lock
from typing import Generic, TypeVar

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
        """Call a function on every thread, with an iterator that gives each item to one of them, and wait for all.

        What it raises is raised once no thread works any more.
        """
        if self._pool is None:
            work(iter(items))
            return
        taken = _Taken(iter(items))
        running = [self._pool.submit(work, taken) for _ in range(self.n)]
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


class _Taken(Generic[T]):
    """An iterator that several threads may take from."""

    def __init__(self, items: Iterator[T]) -> None:
        self._items = items
        self._lock = Lock()

    def __iter__(self) -> Iterator[T]:
        return self

    def __next__(self) -> T:
        with self._lock:
            return next(self._items)
