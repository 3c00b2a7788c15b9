"""What a measurement tells while it runs."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Protocol

from ddic.parallel.phases import Phase
from ddic.problem.weighted_problem import ProblemSize
from ddic.solvers.gauss_newton import IterationRecord

if TYPE_CHECKING:
    from ddic.separated.corrections import CorrectionRecord


class Listener(Protocol):
    """Told on every rank; only rank 0's may speak."""

    def phase(self, phase: Phase) -> None:
        """Take note of a phase that begins."""

    def progress(self, share: float) -> None:
        """Take note of how far the phase at hand is: the share that this rank has done, from 0 to 1."""

    def note(self, line: str) -> None:
        """Take note of something worth a line."""

    def frame(self, number: int, n_frames: int, image: str) -> None:
        """Take note of a frame of a series that begins: its number, from 1, and the name of its image's file."""

    def problem_size(self, size: ProblemSize) -> None:
        """Take note of what is about to be solved."""

    def iteration(self, record: IterationRecord) -> None:
        """Take note of one Gauss-Newton iteration."""

    def correction(self, record: CorrectionRecord) -> None:
        """Take note of one correction of PGD-DIC."""


class Silence:
    """A listener that says nothing."""

    def note(self, *_: object, **__: object) -> None:
        """Ignore."""

    phase = progress = frame = problem_size = iteration = correction = note


class WithoutNotes:
    """Tells another listener how a measurement goes on, but nothing of a field that is not the result.

    Phases are told by their clock, whoever listens.

    Parameters
    ----------
    listener : Listener
        The other one.
    """

    def __init__(self, listener: Listener) -> None:
        self._listener = listener

    def problem_size(self, size: ProblemSize) -> None:
        """Pass it on."""
        self._listener.problem_size(size)

    def iteration(self, record: IterationRecord) -> None:
        """Pass it on."""
        self._listener.iteration(record)

    def note(self, *_: object, **__: object) -> None:
        """Ignore."""

    phase = progress = frame = correction = note


def note_all(listener: Listener, notes: Iterable[str]) -> None:
    """Tell a listener some notes, a line each."""
    for line in notes:
        listener.note(line)
