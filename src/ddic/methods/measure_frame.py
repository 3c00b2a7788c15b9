"""A frame of a series: started from those before it, measured, written; or noted as one that cannot be measured."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ddic.case.frame_files import list_times
from ddic.errors import DdicError, is_collective
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import inputs_kept
from ddic.io.series_folder import BackgroundWriter, SeriesFolder
from ddic.methods.detect import add_notes, measure_and_look
from ddic.methods.frame_starts import SEARCH, KnownFrameStart, choose_known_start, measure_from
from ddic.methods.reference_session import ReferenceSession, place_lines
from ddic.parallel.team import Team
from ddic.results.measurement import Measurement
from ddic.results.series import FrameRecord, MeasuredState, write_failed_frame, write_frame


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

    What cannot be measured is told.

    Parameters
    ----------
    session : ReferenceSession
        Of the reference image in use.
    number : int
        From 1.
    states : sequence of MeasuredState
        Of the last frames that were measured, on the session's subdomains.

    Returns
    -------
    MeasuredFrame
        Measured or not.
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
    """Begin to write a frame, or note that it could not be measured; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    frame : MeasuredFrame
        Measured or not.
    folder : SeriesFolder
        Where finished frames go.
    writer : BackgroundWriter
        Of rank 0.

    Returns
    -------
    MeasuredState or None
        What the next frame starts from; None where it could not be measured.

    Raises
    ------
    OSError
        On all ranks, where it cannot be written.
    """
    record, result = frame.record, frame.result
    if isinstance(result, DdicError):
        write_failed_frame(team, result, record, folder)
        return None
    of_frame = replace(result, inputs=result.inputs.with_frame(record.number - 1))
    return write_frame(of_frame, record, folder, writer)
