"""What the frames of a series are opened, told and timed with, and what is left to do of it.

At its end the frames are joined to one result file, and the summary is written.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from ddic.case.loader import LoadedCase
from ddic.case.named_files import list_cameras, list_deformed, list_times
from ddic.inputs.inputs import FrameOpener, inputs_kept, open_inputs
from ddic.io.join_frames import join_frames
from ddic.io.replace_on_exit import replaced_together
from ddic.io.result_schema import summary_path
from ddic.io.series_folder import FrameState, SeriesFolder
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team
from ddic.results.listener import Listener
from ddic.results.series import N_STATES, FrameRecord, SeriesSummary, write_series_summary


@dataclass(frozen=True)
class SeriesImages:
    """What frames are opened, told and timed with.

    Attributes
    ----------
    team : Team
    opener : FrameOpener
        Of the images.
    listener : Listener
    clock : PhaseClock
    """

    team: Team
    opener: FrameOpener
    listener: Listener
    clock: PhaseClock


def open_series(team: Team, loaded: LoadedCase, number: int, listener: Listener) -> SeriesImages:
    """Open the reference images of a series, and its first frame; collective.

    ``number`` is that of the first frame that is to be measured, from 1. The clock has begun. Raises InputError on all
    ranks where an image cannot be read.
    """
    clock = PhaseClock(entered=listener.phase, advanced=listener.progress, waiting=team.waiting)
    with inputs_kept(team, loaded.stamps), clock.phase(Phase.MESH):
        inputs, first = open_inputs(team, loaded, number - 1)
    return SeriesImages(team, FrameOpener(team, inputs, number, first, loaded.stamps), listener, clock)


@dataclass(frozen=True)
class FramesToMeasure:
    """What is left to do of a series.

    Attributes
    ----------
    numbers : sequence of int
        Frames, from 1, in order.
    before : sequence of FrameRecord
        Of the frames before them, in order.
    states : mapping of int to FrameState
        Of those of them that are needed: the last that were measured, and the one that was the reference image.
    folder : SeriesFolder
        Where finished frames go.
    """

    numbers: Sequence[int]
    before: Sequence[FrameRecord]
    states: Mapping[int, FrameState]
    folder: SeriesFolder


def list_frames_to_measure(team: Team, folder: SeriesFolder, finished: Mapping[int, FrameRecord]) -> FramesToMeasure:
    """List the frames that no earlier run has finished, perhaps none, and read what they go on from; collective."""
    numbers = [number for number in range(1, folder.n_frames + 1) if number not in finished]
    before = [finished[number] for number in sorted(finished) if numbers and number < numbers[0]]
    measured = [record for record in before if record.converged]
    needed = {record.number for record in measured[-N_STATES:]}
    needed |= {record.reference for record in measured[-1:] if record.reference}
    states = team.on_root(lambda: {number: folder.read_state(number) for number in needed})
    return FramesToMeasure(numbers, before, states, folder)


def describe_origin(loaded: LoadedCase) -> dict[str, object]:
    """Say what a series is measured from, as JSON has it, to tell it from others."""
    sections = list_cameras(loaded.case)
    return {"case file": loaded.text, "reference images": [str(section.reference) for section in sections],
            "deformed images": [[str(path) for path in list_deformed(section)] for section in sections],
            "times": list(list_times(loaded.case))}


def finish_series(folder: SeriesFolder, summary: SeriesSummary, origin: Mapping[str, object]) -> None:
    """Join what was measured, and write the summary; the folder of frames goes once every frame was tried.

    The folder is not there where an earlier run has finished the series: nothing is left to do then. ``origin`` is that
    of ``describe_origin``. Raises OSError where one cannot be written; neither is, an earlier result and the frames
    stay.
    """
    if not folder.path.exists():
        return
    measured = [frame.number for frame in summary.frames if frame.converged]
    with replaced_together() as files:
        if measured:
            records = [frame.as_json() for frame in summary.frames]
            join_frames(folder, measured, records, json.dumps(origin), files)
        else:
            summary = replace(summary, result_file="")
        write_series_summary(summary_path(folder.result), summary, files)
    if summary.is_whole:
        folder.remove()
