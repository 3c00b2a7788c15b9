"""Frames of a series on their way to the disk, and back for those that follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ddic.errors import ConvergenceError, DdicError, is_collective
from ddic.io import result_schema as schema
from ddic.io.background_writer import BackgroundWriter
from ddic.io.result_writer import ResultWriter
from ddic.io.series_folder import FrameState, SeriesFolder
from ddic.parallel.team import Team, require_held
from ddic.problem.weighted_problem import WeightedProblem
from ddic.results.measurement import Measurement
from ddic.results.publishing import Destination, pack, publish
from ddic.results.series_record import FrameRecord

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MeasuredState:
    """What a frame starts from of an earlier one.

    Attributes
    ----------
    time : float
        Of the earlier frame, unit chosen by the user.
    q : list of (n_unknowns,) array
        Unknowns of owned subdomains.
    shown_share : float
        Share of the cells that were seen where the field put them.
    holds_back : bool
        Whether mechanics held cells back from where they were seen, so that the field shows no way to the next frame.
    """

    time: float
    q: list[Array]
    shown_share: float
    holds_back: bool


def write_frame(measurement: Measurement, record: FrameRecord, folder: SeriesFolder,
                writer: BackgroundWriter) -> MeasuredState:
    """Begin to write a frame that was measured; collective, only rank 0 touches the disk.

    Parameters
    ----------
    measurement : Measurement
        Of the frame.
    record : FrameRecord
        What is told of it.
    folder : SeriesFolder
        Of the series.
    writer : BackgroundWriter
        Of rank 0.

    Returns
    -------
    MeasuredState
        What the next frame starts from, as it is written.

    Raises
    ------
    OSError
        On all ranks, where the frame before could not be written.
    """
    team = measurement.team
    own = {subdomain.index: np.asarray(q) for subdomain, q in zip(measurement.subdomains, measurement.q, strict=True)}
    gathered = team.gather_to(own, 0)
    state = MeasuredState(record.time, measurement.q, measurement.shown_share, measurement.excluded.has_held_back(team))

    def add(opened: ResultWriter) -> None:
        unknowns = {f"{number:06d}": q for of_rank in require_held(gathered) for number, q in of_rank.items()}
        opened.write_attributes(schema.SERIES, {"record": record.as_json(), "time": record.time,
                                                "noise": np.array(measurement.noise, dtype=float),
                                                "shown_share": state.shown_share, "holds_back": state.holds_back})
        opened.write_arrays(f"{schema.SERIES}/unknowns", unknowns)

    content = pack(measurement, Destination(None, measurement.inputs.case.output.flip_y), add)
    path = folder.get_frame_path(record.number)
    team.on_root(lambda: writer.write(path, require_held(content)))
    return state


def write_failed_frame(team: Team, error: DdicError, record: FrameRecord, folder: SeriesFolder) -> None:
    """Note that a frame could not be measured, and keep its last field; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    error : DdicError
        Why; what it brings is written as the result of a pair that did not converge.
    record : FrameRecord
        What is told of the frame.
    folder : SeriesFolder
        Of the series.
    """
    last = error.last if isinstance(error, ConvergenceError) else None
    if isinstance(last, Measurement):
        path = schema.not_converged_path(folder.result.with_suffix(f".{record.number:06d}{folder.result.suffix}"))
        try:
            publish(last, Destination(path, last.inputs.case.output.flip_y))
        except (OSError, DdicError) as second:
            # That the frame failed is told first; this comes of it.
            if not is_collective(second):
                raise
            record = replace(record, failure=f"{record.failure}; its last field could not be written ({second})")
    team.on_root(lambda: folder.write_failure(record.number, record.as_json()))


def collect_states(problem: WeightedProblem, states: Sequence[FrameState]) -> list[MeasuredState]:
    """Take up what an earlier run has measured; collective.

    Parameters
    ----------
    problem : WeightedProblem
        Whose cameras are weighted as they were.
    states : sequence of FrameState
        Of the last frames.

    Returns
    -------
    list of MeasuredState
        Of owned subdomains; none where the subdomains are others: the next frame is searched for then.
    """
    if states and states[-1].noise and not problem.is_set_up:
        problem.set_noise(states[-1].noise)
    subdomains = problem.reference.subdomains
    n_other = sum(len(state.unknowns.get(subdomain.index, ())) != subdomain.n_unknowns
                  for state in states for subdomain in subdomains)
    if problem.team.sum(n_other):
        return []
    return [MeasuredState(state.time, [state.unknowns[subdomain.index] for subdomain in subdomains], state.shown_share,
                          state.holds_back) for state in states]


def extrapolate(before: MeasuredState, last: MeasuredState, time: float) -> list[Array]:
    """Extrapolate the unknowns of two frames to a third; free of communication.

    Parameters
    ----------
    before, last : MeasuredState
        Of the same subdomains, in order of time.
    time : float
        Of the third.

    Returns
    -------
    list of (n_unknowns,) array
        Linear in time.
    """
    share = (time - last.time) / (last.time - before.time)
    return [q + share * (q - q_before) for q, q_before in zip(last.q, before.q, strict=True)]
