"""Work shared out over threads."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

from ddic.images.threads import Threads

COUNTS = pytest.mark.parametrize("n", [1, 2, 3])


@COUNTS
def test_every_item_is_taken_once(n: int) -> None:
    taken: list[int] = []

    def work(items: Iterator[int]) -> None:
        for item in items:
            taken.append(item)

    def numbers() -> Iterator[int]:
        for number in range(2000):
            # Lets another thread ask in the midst of it, which a generator refuses.
            time.sleep(0)
            yield number

    Threads(n).share(numbers(), work)
    assert sorted(taken) == list(range(2000))


@pytest.mark.parametrize("n", [2, 3])
def test_so_many_threads_work_at_once(n: int) -> None:
    # Nobody passes the barrier before all are there: with fewer threads it breaks.
    together = threading.Barrier(n)
    names: set[str] = set()

    def work(items: Iterator[int]) -> None:
        together.wait(timeout=30)
        names.add(threading.current_thread().name)

    Threads(n).share([], work)
    assert len(names) == n
    assert threading.main_thread().name not in names


def test_one_thread_is_the_callers() -> None:
    found = []
    Threads(1).share([0], lambda items: found.append(threading.current_thread()))
    assert found == [threading.current_thread()]


@COUNTS
@pytest.mark.parametrize(("length", "least"), [(0, 4), (3, 4), (100, 4), (101, 7), (5000, 1)])
def test_slices_cover_a_sequence_once(n: int, length: int, least: int) -> None:
    slices: list[slice] = []
    Threads(n).run_over(length, least, slices.append)
    places = sorted(slices, key=lambda s: s.start)
    assert [i for s in places for i in range(s.start, s.stop)] == list(range(length))
    assert len(slices) == 1 or min(s.stop - s.start for s in slices) >= least
    assert (len(slices) > 1) == (n > 1 and length >= 2 * least)


@COUNTS
def test_error_of_a_thread_is_raised_when_none_works_any_more(n: int) -> None:
    threads, running = Threads(n), []

    def work(items: Iterator[int]) -> None:
        running.append(1)
        try:
            for item in items:
                if item == 7:
                    raise FloatingPointError("item 7")
        finally:
            running.pop()

    with pytest.raises(FloatingPointError, match="item 7"):
        threads.share(range(50), work)
    assert running == []
    # The threads are still there for the next call.
    done: list[slice] = []
    threads.run_over(100, 10, done.append)
    assert sum(s.stop - s.start for s in done) == 100


def test_no_threads_are_refused() -> None:
    with pytest.raises(ValueError, match="at least one"):
        Threads(0)
