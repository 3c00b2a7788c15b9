"""The last field of a measurement that did not converge, kept so that one can look at it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from ddic.errors import ConvergenceError, DdicError, is_collective
from ddic.parallel.phases import Phase, PhaseClock

Finish = Callable[[Any, str], object]
"""Makes a measurement of a solution and the reason why it is no result; collective."""


@contextmanager
def last_field_kept(clock: PhaseClock, finish: Finish) -> Iterator[None]:
    """Let a ConvergenceError bring the measurement of its last field in place of the solver's solution; collective.

    Parameters
    ----------
    clock : PhaseClock
        Of the phases.
    finish : callable
        Makes the measurement.

    Raises
    ------
    ConvergenceError
        As it was raised inside; without a measurement where its solution shows nothing.
    """
    try:
        yield
    except ConvergenceError as error:
        found, error.last = error.last, None
        # Of one that is not raised on all ranks the job ends.
        if found is not None and is_collective(error):
            with clock.phase(Phase.FINISH):
                error.last = _finish(finish, found, str(error))
        raise


def _finish(finish: Finish, found: Any, failure: str) -> object:
    try:
        return finish(found, failure)
    except DdicError as error:
        # Where no pixel is left, say, there is nothing to show; what this rank alone raises must end the job.
        if not is_collective(error):
            raise
        return None
