"""The frames of a series, each started from those before it; one that cannot be measured does not stop the others."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace

from ddic.io.background_writer import BackgroundWriter
from ddic.io.read_ahead import ReadAhead
from ddic.io.series_folder import FrameState, SeriesFolder
from ddic.methods.dd_dic import Session
from ddic.methods.measure_frame import SeriesTools, measure_frame
from ddic.methods.noise_floors import NoiseFloor
from ddic.parallel.phases import PhaseClock
from ddic.parallel.stop_request import StopRequest, is_stop_asked
from ddic.problem.frame_opener import FrameOpener
from ddic.results.listener import Listener
from ddic.results.series_frames import collect_states
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
    """

    numbers: Sequence[int]
    states: Sequence[FrameState]
    folder: SeriesFolder


def measure_frames(opener: FrameOpener, wanted: FramesToMeasure, listener: Listener,
                   clock: PhaseClock) -> list[FrameRecord]:
    """Measure what is left of a series, or what of it a signal leaves time for; collective.

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
    team = opener.team
    records: list[FrameRecord] = []
    with ExitStack() as stack:
        reader, writer = stack.enter_context(ReadAhead()), stack.enter_context(BackgroundWriter())
        first = None if wanted.states else opener.first
        # A frame that has begun is finished: no signal ends it.
        unhurried = replace(team, stop=StopRequest())
        session = stack.enter_context(Session(unhurried, opener.inputs, listener, clock, first))
        tools = SeriesTools(opener, session, wanted.folder, writer, NoiseFloor(session, clock), listener)
        states = collect_states(session.problem, wanted.states)
        for number in wanted.numbers:
            if team.is_root:
                reader.begin(opener.list_files(number + 1))
            listener.frame(number, opener.n_frames, opener.describe(number))
            record, state = measure_frame(tools, number, states)
            states = [*states, state][-N_STATES:] if state is not None else states
            records.append(record)
            listener.note(record.describe())
            if is_stop_asked(team):
                break
        team.on_root(writer.wait)
    return records
