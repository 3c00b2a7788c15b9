"""A frame of a series: started from those before it, measured, written; or noted as one that cannot be measured."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ddic.case.frame_files import list_times
from ddic.errors import DdicError, is_collective
from ddic.io.background_writer import BackgroundWriter
from ddic.io.series_folder import SeriesFolder
from ddic.methods.dd_dic import Session
from ddic.methods.frame_starts import choose_known_start, measure_from
from ddic.methods.noise_floors import NoiseFloor
from ddic.problem.frame_opener import FrameOpener
from ddic.results.listener import Listener
from ddic.results.series_frames import MeasuredState, write_failed_frame, write_frame
from ddic.results.series_record import FrameRecord


@dataclass(frozen=True)
class SeriesTools:
    """What all frames of a series are measured with.

    Attributes
    ----------
    opener : FrameOpener
        Of the images.
    session : Session
        Prepared.
    folder : SeriesFolder
        Where finished frames go.
    writer : BackgroundWriter
        Of rank 0.
    floor : NoiseFloor
        Of the frames.
    listener : Listener
        Told what happens.
    """

    opener: FrameOpener
    session: Session
    folder: SeriesFolder
    writer: BackgroundWriter
    floor: NoiseFloor
    listener: Listener


def measure_frame(tools: SeriesTools, number: int,
                  states: Sequence[MeasuredState]) -> tuple[FrameRecord, MeasuredState | None]:
    """Measure a frame and begin to write it; collective. What cannot be measured is noted.

    Parameters
    ----------
    tools : SeriesTools
        What it is measured with.
    number : int
        From 1.
    states : sequence of MeasuredState
        Of the last frames that were measured.

    Returns
    -------
    record : FrameRecord
        What is told of it.
    state : MeasuredState or None
        What the next frame starts from; None where it could not be measured.

    Raises
    ------
    OSError
        On all ranks, where it cannot be written.
    """
    opener, case = tools.opener, tools.opener.inputs.case
    record = FrameRecord(number, opener.describe(number), list_times(case)[number - 1], converged=False)
    began = time.perf_counter()
    try:
        frame = opener.open(number)
        known = choose_known_start(case.series.start, states, record.time)
        measurement, start = measure_from(tools.session, frame, known, tools.listener)
    except DdicError as error:
        if not is_collective(error):
            raise
        failed = replace(record, failure=str(error))
        write_failed_frame(opener.team, error, failed, tools.folder)
        return failed, None
    deviation = measurement.evaluation.grey[0].residual_std
    record = replace(record, converged=True, iterations=len(measurement.records), started_from=start,
                     residual_std_grey=deviation, noise_floor_px=tools.floor.estimate(measurement),
                     notes=measurement.notes, seconds=float(opener.team.maximum(time.perf_counter() - began)))
    of_frame = replace(measurement, inputs=measurement.inputs.with_frame(number - 1))
    return record, write_frame(of_frame, record, tools.folder, tools.writer)
