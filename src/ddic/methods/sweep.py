"""Element sizes and cut-off wavelengths compared on the pair and on virtual images made from it.

A candidate is one element size and one cut-off wavelength: prepared, and measured with.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack

import numpy as np

from ddic.errors import DdicError, is_collective
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs
from ddic.io.result_reader import Result
from ddic.methods.dd_dic import DecomposedSession
from ddic.methods.sweep_errors import (
    NOWHERE,
    collect_trial,
    correct_predictions,
    draw_points,
    estimate_pair_noise,
    evaluate_pair,
    evaluate_virtual,
    predict_errors,
)
from ddic.methods.virtual_frames import VirtualFrames, VirtualTruth
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team, require_held
from ddic.results.listener import Silence
from ddic.results.publishing import gather
from ddic.results.sweep import Candidate, Sweep, Trial, choose_trial
from ddic.start.given_start import EarlierResult, keep_displacement


class CandidateSession:
    """A candidate, prepared at its first measurement; use it in a ``with`` statement.

    Parameters
    ----------
    team : Team
        All ranks.
    candidate : Candidate
        What is tried.
    inputs : Inputs
        With its case and mesh.
    stays_open : bool
        Whether images, M and factors are kept from one measurement to the next.
    """

    def __init__(self, team: Team, candidate: Candidate, inputs: Inputs, *, stays_open: bool) -> None:
        self.candidate, self._team, self._inputs, self._stays_open = candidate, team, inputs, stays_open
        self._session: DecomposedSession | None = None

    def __enter__(self) -> CandidateSession:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def measure_pair(self, frame: Frame, start: EarlierResult | None) -> tuple[Trial, Result | None]:
        """Measure the pair of the case; collective.

        ``start`` is a displacement to start from; None: it is searched for. Where nothing was measured the reason is in
        the trial: one candidate that fails ends no sweep.
        """
        try:
            session = self._open()
            return collect_trial(self.candidate, session.problem, session.measure(frame, start))
        except DdicError as error:
            # What this rank alone raises must end the job.
            if not is_collective(error):
                raise
            self.close()
            return Trial(self.candidate, NOWHERE, failure=str(error)), None
        finally:
            self._finish()

    def measure_virtual(self, frame: Frame, start: EarlierResult) -> Result | None:
        """Measure a virtual image from a start; collective. The field is on every rank, None where there is none."""
        try:
            return gather(self._open().measure(frame, start))
        except DdicError as error:
            if not is_collective(error):
                raise
            self.close()
            return None
        finally:
            self._finish()

    def close(self) -> None:
        """Free the factors."""
        if self._session is not None:
            self._session.close()
        self._session = None

    def _open(self) -> DecomposedSession:
        if self._session is None:
            self._session = DecomposedSession(self._team, self._inputs, Silence(),
                                              PhaseClock(waiting=self._team.waiting))
        return self._session

    def _finish(self) -> None:
        if not self._stays_open:
            self.close()


KEPT_PIXELS = 50_000_000
"""Pixels of all candidates together up to which their images, M and factors are kept, 20 to 40 bytes a pixel; others
are prepared twice. A larger value takes more memory."""

Advance = Callable[[str], None]
"""Told what is measured next."""


def measure_candidates(team: Team, varied: Sequence[tuple[Candidate, Inputs]], frame: Frame, advance: Advance) -> Sweep:
    """Measure the pair and the virtual images with every candidate, and choose one; collective.

    ``varied`` has candidates with their inputs, the case's own first, of one camera; ``advance`` is told what is
    measured next, twice for each candidate. The sweep is the same on all ranks. Raises ConvergenceError on all ranks,
    where no candidate measures the pair, or the virtual images.
    """
    images = VirtualFrames(team, varied[0][1])
    stays_open = images.reference.extent.n_pixels * len(varied) <= KEPT_PIXELS
    with ExitStack() as stack:
        sessions = [stack.enter_context(CandidateSession(team, candidate, inputs, stays_open=stays_open))
                    for candidate, inputs in varied]
        trials, fields = _measure_pair(sessions, frame, advance)
        points = team.alike(lambda: draw_points(trials, fields))
        trials = [evaluate_pair(trial, field, points, images.material)
                  for trial, field in zip(trials, fields, strict=True)]
        noise = estimate_pair_noise(trials, images.find_noise_transfer(trials))
        trials = predict_errors(trials, noise, images.measure_gradient(points))
        known = int(np.nanargmin([trial.predicted_error for trial in trials]))
        field = require_held(fields[known])
        start = keep_displacement(field, "the measured field")
        truth = VirtualTruth(field.mesh, field.displacement)
        again = sessions[known].measure_virtual(images.render(truth, 0.0), start)
        truth = truth if again is None else truth.with_lost_detail(again)
        virtual = images.render(truth, float(np.sqrt(noise.of_field)))
        for number, session in enumerate(sessions):
            advance(f"virtual images, {trials[number].candidate.describe()}")
            if not trials[number].failure:
                measured = session.measure_virtual(virtual, start)
                trials[number] = evaluate_virtual(trials[number], measured, truth, points)
    trials = correct_predictions(trials, known)
    chosen = team.alike(lambda: choose_trial(trials))
    return Sweep(tuple(trials), points, noise.camera, known, chosen)


def _measure_pair(sessions: Sequence[CandidateSession], frame: Frame,
                  advance: Advance) -> tuple[list[Trial], list[Result | None]]:
    """What each measures of the pair, from the second on starting from the first field."""
    trials: list[Trial] = []
    fields: list[Result | None] = []
    start = None
    for session in sessions:
        advance(f"images of the case, {session.candidate.describe()}")
        trial, field = session.measure_pair(frame, start)
        trials.append(trial)
        fields.append(field)
        if start is None and field is not None:
            start = keep_displacement(field, "the first field")
    return trials, fields
