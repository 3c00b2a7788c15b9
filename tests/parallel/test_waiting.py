"""Waiting asleep."""

from __future__ import annotations

import time

from ddic.parallel.team import Waiting


def test_a_long_wait_takes_little_of_the_processor() -> None:
    end = time.perf_counter() + 0.3
    began = time.process_time()
    Waiting().wait_until(lambda: time.perf_counter() > end)
    assert time.process_time() - began < 0.15


def test_what_is_done_is_not_waited_for() -> None:
    began = time.perf_counter()
    Waiting().wait_until(lambda: True)
    assert time.perf_counter() - began < 0.05
