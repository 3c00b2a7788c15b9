"""PGD-DIC: successive rank-one corrections of a displacement that is a sum of products, Fig. 2 of [PP12]."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.stop_request import stop_if_asked
from ddic.parallel.team import Team
from ddic.problem.separated_problem import prepare_separated_problem
from ddic.results.listener import Listener
from ddic.results.measurement import last_field_kept
from ddic.results.separated import SeparatedMeasurement, finish_separated
from ddic.separated.corrections import CorrectionRecord, correct_displacement
from ddic.start.separated_start import KnownSeparatedStart, find_separated_start, prepare_separated_search


class SeparatedSession:
    """A prepared PGD-DIC measurement, for any number of frames; use it in a ``with`` statement as other sessions.

    Raises InputError on all ranks.

    Parameters
    ----------
    team : Team
        All ranks, each of which reads some bands of rows.
    inputs : Inputs
        Reference image, rectangle and settings.
    listener : Listener
        Told what happens.
    clock : PhaseClock
        Of the phases.
    """

    def __init__(self, team: Team, inputs: Inputs, listener: Listener, clock: PhaseClock) -> None:
        self._listener, self._clock = listener, clock
        self._problem = prepare_separated_problem(team, inputs, clock)
        with clock.phase(Phase.START):
            self._search = prepare_separated_search(self._problem)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()

    def measure(self, frame: Frame, start: KnownSeparatedStart | None = None) -> SeparatedMeasurement:
        """Measure the displacement between the reference image and a frame; collective.

        ``start`` is a displacement to start from, or to go on from; by default the case says where. Raises InputError,
        SingularSubdomainError, or ConvergenceError with the last field, on all ranks; the session can measure other
        frames afterwards.
        """
        problem = self._problem
        with self._clock.phase(Phase.START):
            begin, notes = find_separated_start(problem, self._search, frame, start)
        for line in notes:
            self._listener.note(line)
        self._listener.problem_size(problem.size)
        pixels = problem.open_frame(frame)
        with (last_field_kept(self._clock, lambda *found: finish_separated(problem, frame, pixels, notes, *found)),
              self._clock.phase(Phase.LINEAR_STEP)):
            solution = problem.team.alike(lambda: correct_displacement(
                pixels, begin, problem.regularization, problem.scheme, problem.rules, self._report))
        self._listener.note(solution.stop)
        with self._clock.phase(Phase.FINISH):
            return finish_separated(problem, frame, pixels, notes, solution)

    def _report(self, record: CorrectionRecord) -> None:
        """Tell a correction, and end there where a signal asked for it."""
        self._listener.correction(record)
        stop_if_asked(self._problem.team, f"after correction {record.number}, before it converged")

    def close(self) -> None:
        """Do nothing: there is no object of PETSc to free."""
