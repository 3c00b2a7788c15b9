"""What is left to do of a series."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ddic.io.series_folder import FrameState, SeriesFolder
from ddic.parallel.team import Team
from ddic.results.frame_states import N_STATES
from ddic.results.series_record import FrameRecord


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
    """List the frames that are not finished, and read what they go on from; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    folder : SeriesFolder
        Of the frames.
    finished : mapping of int to FrameRecord
        Of those that an earlier run has finished.

    Returns
    -------
    FramesToMeasure
        Without frames where all are finished.
    """
    numbers = [number for number in range(1, folder.n_frames + 1) if number not in finished]
    before = [finished[number] for number in sorted(finished) if numbers and number < numbers[0]]
    measured = [record for record in before if record.converged]
    needed = {record.number for record in measured[-N_STATES:]}
    needed |= {record.reference for record in measured[-1:] if record.reference}
    states = team.on_root(lambda: {number: folder.read_state(number) for number in needed})
    return FramesToMeasure(numbers, before, states, folder)
