"""A frame of a series: started from those before it, measured, written; or noted as one that cannot be measured."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ddic.case.frame_files import list_times
from ddic.errors import DdicError, is_collective
from ddic.io.background_writer import BackgroundWriter
from ddic.io.series_folder import SeriesFolder
from ddic.methods.frame_starts import choose_known_start, measure_from
from ddic.methods.reference_session import ReferenceSession
from ddic.parallel.team import Team
from ddic.problem.inputs import inputs_kept
from ddic.results.frame_states import MeasuredState
from ddic.results.measurement import Measurement
from ddic.results.series_frames import write_failed_frame, write_frame
from ddic.results.series_record import FrameRecord


@dataclass(frozen=True)
class MeasuredFrame:
    """What became of a frame.

    Attributes
    ----------
    record : FrameRecord
        What is told of it.
    result : Measurement or DdicError
        Its field, or why it could not be measured.
    """

    record: FrameRecord
    result: Measurement | DdicError


def measure_frame(session: ReferenceSession, number: int, states: Sequence[MeasuredState]) -> MeasuredFrame:
    """Measure a frame; collective. What cannot be measured is told.

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
                         reference=session.frame)
    began = time.perf_counter()
    try:
        with inputs_kept(images.team, opener.choose_stamps(number)):
            frame = opener.open(number)
            known = choose_known_start(case.series.start, states, record.time)
            measurement, start = measure_from(session.session, frame, known, images.listener)
    except DdicError as error:
        if not is_collective(error):
            raise
        return MeasuredFrame(replace(record, failure=str(error)), error)
    deviation = measurement.evaluation.grey[0].residual_std
    record = replace(record, converged=True, iterations=measurement.n_iterations, started_from=start,
                     residual_std_grey=deviation, noise_floor_px=session.estimate_noise_floor(measurement),
                     notes=measurement.notes, seconds=float(images.team.maximum(time.perf_counter() - began)))
    return MeasuredFrame(record, measurement)


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
