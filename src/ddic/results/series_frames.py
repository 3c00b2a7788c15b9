"""Frames of a series on their way to the disk."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ddic.errors import ConvergenceError, DdicError, is_collective
from ddic.io import result_schema as schema
from ddic.io.result_writer import ResultWriter
from ddic.io.series_folder import BackgroundWriter, SeriesFolder
from ddic.parallel.team import Team, require_held
from ddic.results.frame_states import MeasuredState
from ddic.results.measurement import Measurement
from ddic.results.publishing import Destination, pack, publish
from ddic.results.series_record import FrameRecord


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
    unknowns = measurement.unknowns
    own = {f"{subdomain.index:06d}": np.asarray(q)
           for subdomain, q in zip(measurement.subdomains, unknowns, strict=True)}
    gathered = team.gather_to(own, 0)
    state = MeasuredState(record.time, unknowns, measurement.shown_share, measurement.excluded.has_held_off(team))

    def add(opened: ResultWriter) -> None:
        by_subdomain = {name: q for of_rank in require_held(gathered) for name, q in of_rank.items()}
        opened.write_attributes(schema.SERIES, {"record": record.as_json(), "time": record.time,
                                                "noise": np.array(measurement.noise, dtype=float),
                                                "shown_share": state.shown_share, "holds_back": state.holds_back})
        opened.write_arrays(f"{schema.SERIES}/unknowns", by_subdomain)

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
