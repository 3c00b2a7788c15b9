"""The frames of a series, each started from those before it; one that cannot be measured does not stop the others."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace

from ddic.case.frame_files import list_times
from ddic.errors import DdicError, is_collective
from ddic.io.background_writer import BackgroundWriter
from ddic.io.read_ahead import ReadAhead
from ddic.io.series_folder import FrameState, SeriesFolder
from ddic.methods.choose_recipe import NoiseFloor
from ddic.methods.dd_dic import Session
from ddic.methods.frame_starts import list_starts, measure_from
from ddic.parallel.phases import PhaseClock
from ddic.problem.cameras import Frame
from ddic.problem.frame_opener import FrameOpener
from ddic.results.listener import Listener
from ddic.results.series_frames import MeasuredState, take_states, write_failed_frame, write_frame
from ddic.results.series_record import FrameRecord

N_STATES = 2
"""Frames from which the next one is extrapolated."""


@dataclass(frozen=True)
class FramesToMeasure:
    """What is left to do of a series.

    Attributes
    ----------
    numbers : sequence of int
        Frames, from 1, in order.
    states : sequence of FrameState
        Of the last frames before them that were measured, two at most, in order.
    folder : SeriesFolder
        Where finished frames go.
    first : Frame
        Images of the first of them.
    """

    numbers: Sequence[int]
    states: Sequence[FrameState]
    folder: SeriesFolder
    first: Frame


def measure_frames(opener: FrameOpener, wanted: FramesToMeasure, listener: Listener,
                   clock: PhaseClock) -> list[FrameRecord]:
    """Measure what is left of a series; collective.

    Parameters
    ----------
    opener : FrameOpener
        Of the images.
    wanted : FramesToMeasure
        Which.
    listener : Listener
        Told what happens.
    clock : PhaseClock
        Of the phases.

    Returns
    -------
    list of FrameRecord
        Of each; the same on all ranks.

    Raises
    ------
    InputError, SingularSubdomainError, FactorizationError, OSError
        On all ranks, where nothing can be prepared, or no frame can be written.
    """
    team, numbers = opener.team, wanted.numbers
    records: list[FrameRecord] = []
    with ExitStack() as stack:
        reader, writer = stack.enter_context(ReadAhead()), stack.enter_context(BackgroundWriter())
        session = stack.enter_context(Session(team, opener.inputs, listener, clock,
                                              None if wanted.states else wanted.first))
        series = _Series(opener, session, wanted, writer, listener)
        states = take_states(session.problem, wanted.states)
        floor = NoiseFloor(session, clock)
        for number in numbers:
            if team.is_root:
                reader.begin(opener.list_files(number + 1))
            listener.frame(number, opener.n_frames, opener.name(number))
            record, state = _measure_frame(series, number, states, floor)
            states = [*states, state][-N_STATES:] if state is not None else states
            records.append(record)
            listener.note(record.describe())
        team.on_root(writer.wait)
    return records


@dataclass(frozen=True)
class _Series:
    """What all frames are measured with."""

    opener: FrameOpener
    session: Session
    wanted: FramesToMeasure
    writer: BackgroundWriter
    listener: Listener


def _measure_frame(series: _Series, number: int, states: Sequence[MeasuredState],
                   floor: NoiseFloor) -> tuple[FrameRecord, MeasuredState | None]:
    """Measure a frame and begin to write it; what cannot be measured is noted."""
    opener, wanted = series.opener, series.wanted
    case = opener.inputs.case
    record = FrameRecord(number, opener.name(number), list_times(case)[number - 1], converged=False)
    began = time.perf_counter()
    try:
        frame = wanted.first if number == wanted.numbers[0] else opener.open(number)
        starts = list_starts(case.series.start, states, record.time)
        measurement, start = measure_from(series.session, frame, starts, series.listener)
    except DdicError as error:
        if not is_collective(error):
            raise
        failed = replace(record, failure=str(error))
        write_failed_frame(opener.team, error, failed, wanted.folder)
        return failed, None
    deviation = measurement.evaluation.grey[0].residual_std
    record = replace(record, converged=True, iterations=len(measurement.records), started_from=start,
                     residual_std_grey=deviation, noise_floor_px=floor.estimate(measurement), notes=measurement.notes,
                     seconds=float(opener.team.maximum(time.perf_counter() - began)))
    of_frame = replace(measurement, inputs=measurement.inputs.at_frame(number - 1))
    write_frame(of_frame, record, wanted.folder, series.writer)
    return record, MeasuredState(record.time, measurement.q)
