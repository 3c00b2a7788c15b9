"""A frame of a series: started from those before it, measured, written; or noted as one that cannot be measured.

It starts from what frames before it extrapolate to, or from a search. Finished frames are known as far as the next one
needs them. Also: when a frame becomes the reference image of those that follow.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ddic.case.named_files import list_times
from ddic.errors import ConvergenceError, DdicError, SingularSubdomainError, is_collective
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import inputs_kept
from ddic.io.series_folder import BackgroundWriter, SeriesFolder
from ddic.methods.dd_dic import Session
from ddic.methods.detect import add_notes, measure_and_look
from ddic.methods.reference_session import ReferenceSession, place_lines
from ddic.parallel.team import Team
from ddic.results.listener import Listener
from ddic.results.measurement import Measurement
from ddic.results.series import N_STATES, FrameRecord, MeasuredState, extrapolate, write_failed_frame, write_frame

SEARCH = "a search"
"""Name of a start that nothing is known of."""

LEAST_SHOWN = 0.8
"""Share of the cells that the last frame showed which a start must show, else it is searched for: Gauss-Newton takes
long, or does not find its way, from other speckle. A larger share searches more often."""


@dataclass(frozen=True)
class KnownFrameStart:
    """What earlier frames say of where a frame starts.

    Attributes
    ----------
    name : str
        For the log.
    q : sequence of (n_unknowns,) array
        Unknowns of owned subdomains since the first reference image.
    least_shown : float
        Share of the cells that it must show.
    """

    name: str
    q: Sequence[NDArray[np.float64]]
    least_shown: float


def choose_known_start(wanted: str, states: Sequence[MeasuredState], time: float) -> KnownFrameStart | None:
    """Choose what a frame starts from of those before it; None where it is to be searched for.

    ``wanted`` is ``series.start`` of the case; ``states`` are those of the last frames that were measured, two at most;
    ``time`` is the frame's, unit chosen by the user.
    """
    # A field that mechanics hold off what its frame showed would take what it sees for something else.
    if wanted == "search" or not states or states[-1].holds_back:
        return None
    last, least_shown = states[-1], LEAST_SHOWN * states[-1].shown_share
    if wanted == "extrapolate" and len(states) > 1:
        return KnownFrameStart("the last two frames", extrapolate(states[-2], last, time), least_shown)
    return KnownFrameStart("the last frame", last.q, least_shown)


def measure_from(session: Session, frame: Frame, known: KnownFrameStart | None,
                 listener: Listener) -> tuple[Measurement, str]:
    """Measure a frame from a known start, or from a search where there is none or that leads nowhere; collective.

    What earlier frames changed of the session's operators is forgotten. Returns the measurement and the name of the
    start. Raises InputError, ConvergenceError or SingularSubdomainError on all ranks, where the search does not
    converge either.
    """
    if known is not None:
        session.begin_anew()
        try:
            start = session.problem.reference.convert_to_reference(known.q)
            return session.measure(frame, start, known.least_shown), known.name
        except (ConvergenceError, SingularSubdomainError) as error:
            if not is_collective(error):
                raise
            listener.note(f"from {known.name}: {error}; it is searched for")
    session.begin_anew()
    return session.measure(frame), SEARCH


@dataclass(frozen=True)
class MeasuredFrame:
    """What became of a frame.

    Attributes
    ----------
    record : FrameRecord
        What is told of it.
    result : Measurement or DdicError
        Its field, or why it could not be measured.
    session : ReferenceSession
        That measured it: another one than was asked where lines were refined, which the caller has to close then.
    """

    record: FrameRecord
    result: Measurement | DdicError
    session: ReferenceSession


def measure_frame(session: ReferenceSession, number: int, states: Sequence[MeasuredState]) -> MeasuredFrame:
    """Measure a frame, once more where its residual says that lines are off; collective.

    What cannot be measured is told. Frames are numbered from 1; ``states`` are those of the last frames that were
    measured, on the session's subdomains.
    """
    images, opener = session.images, session.images.opener
    case = opener.inputs.case
    record = FrameRecord(number, opener.describe(number), list_times(case)[number - 1], converged=False,
                         reference=session.frame, lines=session.lines)
    began = time.perf_counter()
    try:
        with inputs_kept(images.team, opener.choose_stamps(number)):
            frame = opener.open(number)
            known = choose_known_start(case.series.start, states, record.time)
            session, measurement, start = _measure_on_lines(session, frame, known)
    except DdicError as error:
        if not is_collective(error):
            raise
        return MeasuredFrame(replace(record, failure=str(error)), error, session)
    deviation = measurement.evaluation.grey[0].residual_std
    record = replace(record, converged=True, iterations=measurement.n_iterations, started_from=start,
                     lines=session.lines,
                     residual_std_grey=deviation, noise_floor_px=session.estimate_noise_floor(measurement),
                     notes=measurement.notes, seconds=float(images.team.maximum(time.perf_counter() - began)))
    return MeasuredFrame(record, measurement, session)


def _measure_on_lines(session: ReferenceSession, frame: Frame, known: KnownFrameStart | None
                      ) -> tuple[ReferenceSession, Measurement, str]:
    """Measure a frame with a session, or with one of lines that it refines; and where it started; collective."""
    images, start = session.images, SEARCH
    inputs = place_lines(images.opener.inputs, session.lines)

    def measure() -> Measurement:
        nonlocal start
        measurement, start = measure_from(session.session, frame, known, images.listener)
        return measurement

    measured = measure_and_look(measure, images.team, inputs, frame, images.listener, images.clock)
    if isinstance(measured, Measurement):
        return session, measured, start
    lines = tuple(section.vertices or () for section in measured.case.discontinuity)
    refined = ReferenceSession.prepare(images, lines, frame)
    try:
        measurement, start = measure_from(refined.session, frame, None, images.listener)
    except DdicError:
        refined.close()
        raise
    # They are of this frame alone: a series that is resumed knows the lines, not how they were found.
    return refined, add_notes(measurement, measured.notes[len(inputs.notes):]), start


def keep_frame(team: Team, frame: MeasuredFrame, folder: SeriesFolder,
               writer: BackgroundWriter) -> MeasuredState | None:
    """Begin to write a frame, or note that it could not be measured; collective, the writer is rank 0's.

    Returns what the next frame starts from, None where it could not be measured. Raises OSError on all ranks where it
    cannot be written.
    """
    record, result = frame.record, frame.result
    if isinstance(result, DdicError):
        write_failed_frame(team, result, record, folder)
        return None
    of_frame = replace(result, inputs=result.inputs.with_frame(record.number - 1))
    return write_frame(of_frame, record, folder, writer)


@dataclass(frozen=True)
class FramesSoFar:
    """What the next frame goes on from.

    Attributes
    ----------
    session : ReferenceSession
        Of the reference image in use.
    records : sequence of FrameRecord
        Of all frames so far, in order.
    states : sequence of MeasuredState
        Of the last that were measured, two at most, on the session's subdomains.
    """

    session: ReferenceSession
    records: Sequence[FrameRecord]
    states: Sequence[MeasuredState]

    def add(self, session: ReferenceSession, record: FrameRecord, state: MeasuredState | None) -> FramesSoFar:
        """Add a frame; collective. The session so far is closed where another one has taken its place.

        ``session`` measured the frame; ``state`` is None where it could not be measured.
        """
        states = session.restrict_states(self.session, self.states)
        if session is not self.session:
            self.session.close()
        states = states if state is None else [*states, state]
        return FramesSoFar(session, [*self.records, record], states[-N_STATES:])

    def find_last_measured(self) -> FrameRecord | None:
        """Find the last frame that was measured; None where none was, or where nothing is known of its field."""
        measured = [record for record in self.records if record.converged]
        return measured[-1] if measured and self.states else None


RESIDUAL_GROWTH = 1.5
"""Residual of a frame over that of the first one with the same reference image, from which on ``auto`` updates it: a
third of the residual is then light and speckle that have changed. A larger value updates later."""


def measure_with_updates(so_far: FramesSoFar, number: int) -> tuple[MeasuredFrame, ReferenceSession]:
    """Measure a frame, with the last one that was measured as its reference image where that is due; collective.

    Frames are numbered from 1. Returns the frame, measured or not, and the session that measured it; where it is
    another one the caller has to close one of them.
    """
    session = so_far.session
    section, last = session.images.opener.inputs.case.series, so_far.find_last_measured()
    can_update = last is not None and last.number != session.frame
    if can_update and section.incremental == "always" and number - session.frame > section.update_after:
        updated = _update(so_far, last)
        if updated is not None:
            return measure_frame(updated, number, updated.restrict_states(session, so_far.states)), updated
    frame = measure_frame(session, number, so_far.states)
    if can_update and section.incremental == "auto" and _asks_for_update(frame.record, so_far.records):
        updated = _update(so_far, last)
        if updated is not None:
            again = measure_frame(updated, number, updated.restrict_states(session, so_far.states))
            if _is_better(again.record, frame.record):
                return again, updated
            updated.close()
    return frame, frame.session


def _update(so_far: FramesSoFar, last: FrameRecord | None) -> ReferenceSession | None:
    """A session that compares with the last frame that was measured; None where that cannot be prepared; collective."""
    session = so_far.session
    listener = session.images.listener
    if last is None:
        return None
    try:
        updated = session.update(last, so_far.states[-1])
    except DdicError as error:
        if not is_collective(error):
            raise
        listener.note(f"frame {last.number} cannot be the reference image: {error}")
        return None
    listener.note(f"frame {last.number} is the reference image from here on; its error adds up to those that follow")
    return updated


def _asks_for_update(record: FrameRecord, records: Sequence[FrameRecord]) -> bool:
    """Whether a frame was not measured, or its residual has grown."""
    compared = [other.residual_std_grey for other in records if other.converged and other.reference == record.reference]
    if not record.converged:
        return True
    return bool(compared) and record.residual_std_grey > RESIDUAL_GROWTH * compared[0]


def _is_better(again: FrameRecord, before: FrameRecord) -> bool:
    if not (again.converged and before.converged):
        return again.converged
    return again.residual_std_grey < before.residual_std_grey
