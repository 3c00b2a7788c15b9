"""What a measurement tells while it runs."""

from __future__ import annotations

from typing import Protocol

from ddic.parallel.phases import Phase
from ddic.problem.problem_size import ProblemSize
from ddic.solvers.gauss_newton import IterationRecord


class Listener(Protocol):
    """Told on every rank; only rank 0's may speak."""

    def phase(self, phase: Phase) -> None:
        """Take note of a phase that begins.

        Parameters
        ----------
        phase : Phase
            Its name.
        """
        ...

    def note(self, line: str) -> None:
        """Take note of something worth a line.

        Parameters
        ----------
        line : str
            What to tell.
        """
        ...

    def problem_size(self, size: ProblemSize) -> None:
        """Take note of what is about to be solved.

        Parameters
        ----------
        size : ProblemSize
            Sizes and weights.
        """
        ...

    def iteration(self, record: IterationRecord) -> None:
        """Take note of one Gauss-Newton iteration.

        Parameters
        ----------
        record : IterationRecord
            Of it.
        """
        ...


class Silence(Listener):
    """Says nothing."""

    def phase(self, phase: Phase) -> None:
        """Ignore."""

    def note(self, line: str) -> None:
        """Ignore."""

    def problem_size(self, size: ProblemSize) -> None:
        """Ignore."""

    def iteration(self, record: IterationRecord) -> None:
        """Ignore."""
