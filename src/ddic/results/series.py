"""What is told of the frames of a series: each in a line, all in the summary.

Also what the next frames start from, fields of those before them on the subdomains in use; and frames on their way to
the disk.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.errors import ConvergenceError, DdicError, is_collective
from ddic.io import result_schema as schema
from ddic.io.replace_on_exit import NewFiles
from ddic.io.result_writer import ResultWriter
from ddic.io.series_folder import BackgroundWriter, FrameState, SeriesFolder
from ddic.io.text_files import convert_to_json, write_json
from ddic.parallel.team import Team, require_held
from ddic.partition.subdomain import Subdomain
from ddic.problem.weighted_problem import WeightedProblem
from ddic.results.measurement import Measurement, place_at_nodes
from ddic.results.publishing import Destination, pack, publish

Vertices = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class FrameRecord:
    """One frame of a series.

    Attributes
    ----------
    number : int
        From 1.
    image : str
        The far camera's deformed image.
    time : float
        Unit chosen by the user.
    converged : bool
        Whether it was measured.
    iterations : int
        Of Gauss-Newton.
    residual_std_grey : float
        Standard deviation of the residual, grey levels.
    noise_floor_px : float
        RMS displacement that noise of the residual's size leaves, pixels; nan where it is not estimated.
    seconds : float
        Wall time, the slowest rank's.
    started_from : str
        Where Gauss-Newton started.
    reference : int
        Frame whose image was the reference image; 0 for the first one.
    failure : str
        Why it was not measured; empty where it was.
    notes : sequence of str
        What the user should know.
    lines : tuple of tuple of (x, y)
        Vertices of the discontinuities that it was measured with where the residual of this frame or an earlier one has
        refined them, pixels; empty where they are those of the case.
    """

    number: int
    image: str
    time: float
    converged: bool
    iterations: int = 0
    residual_std_grey: float = float("nan")
    noise_floor_px: float = float("nan")
    seconds: float = float("nan")
    started_from: str = ""
    reference: int = 0
    failure: str = ""
    notes: Sequence[str] = field(default_factory=tuple)
    lines: tuple[Vertices, ...] = ()

    def as_json(self) -> str:
        """Write it as a line of JSON, with null for what is not finite."""
        return json.dumps(convert_to_json(asdict(self)), allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> FrameRecord:
        """Read back what ``as_json`` wrote."""
        values: dict[str, Any] = json.loads(text)
        finite: dict[str, Any] = {name: float("nan") if value is None else value for name, value in values.items()}
        finite["lines"] = tuple(tuple((x, y) for x, y in line) for line in values.get("lines", ()))
        return cls(**finite)

    def describe(self) -> str:
        """Say in a line of the log what became of the frame."""
        if not self.converged:
            return f"frame {self.number}: not measured ({self.failure})"
        compared = f", compared with frame {self.reference}" if self.reference else ""
        return (f"frame {self.number}: {self.iterations} iterations from {self.started_from}{compared}, residual "
                f"{self.residual_std_grey:.3f} grey levels, {self.seconds:.2f} s")


@dataclass(frozen=True)
class SeriesSummary:
    """What a series came to.

    Attributes
    ----------
    frames : sequence of FrameRecord
        Those that are finished, in order.
    n_frames : int
        Those that were asked for.
    result_file : str
        Name of the result file; of its folder of frames where it is not whole.
    seconds : float
        Wall time of this run.
    n_resumed : int
        Frames that an earlier run had finished.
    case : dict
        Path and text of the case file.
    """

    frames: Sequence[FrameRecord]
    n_frames: int
    result_file: str
    seconds: float
    n_resumed: int = 0
    case: Mapping[str, str] = field(default_factory=dict)

    @property
    def is_whole(self) -> bool:
        """Whether every frame was tried."""
        return len(self.frames) == self.n_frames

    @property
    def failures(self) -> list[FrameRecord]:
        """The frames that could not be measured."""
        return [frame for frame in self.frames if not frame.converged]


def write_series_summary(path: Path, summary: SeriesSummary, files: NewFiles | None = None) -> None:
    """Write a summary as JSON, under a temporary name that is then changed; numbers that are not finite become null.

    It takes its name with ``files``, by default by itself. Raises InputError where the folder cannot be written to.
    """
    of_run = {name: value for name, value in asdict(summary).items() if name != "frames"}
    write_json(path, {"converged": summary.is_whole and not summary.failures, "whole": summary.is_whole, **of_run,
                      "frames": [asdict(frame) for frame in summary.frames]}, files)


Array = NDArray[np.float64]

N_STATES = 2
"""Frames from which the next one is extrapolated."""


@dataclass(frozen=True)
class MeasuredState:
    """What a frame starts from of an earlier one.

    Attributes
    ----------
    time : float
        Of the earlier frame, unit chosen by the user.
    q : sequence of (n_unknowns,) array
        Unknowns of owned subdomains since the first reference image.
    shown_share : float
        Share of the cells that were seen where the field put them.
    holds_back : bool
        Whether mechanics held cells back from where they were seen, so that the field shows no way to the next frame.
    """

    time: float
    q: Sequence[Array]
    shown_share: float
    holds_back: bool

    def gather(self, team: Team, subdomains: Sequence[Subdomain], n_nodes: int) -> Array:
        """Gather the displacement of all nodes since the first reference image, (n_nodes, 2), pixels; collective.

        The result is on all ranks. The unknowns of the subdomains are displacements of nodes.
        """
        own = [(subdomain.node_ids, q.reshape(-1, 2)) for subdomain, q in zip(subdomains, self.q, strict=True)]
        return place_at_nodes(team.gather_lists(own), n_nodes)

    def restrict(self, displacement: Array, subdomains: Sequence[Subdomain]) -> MeasuredState:
        """Give the same state on other subdomains, from the displacement of ``gather``, (n_nodes, 2), pixels."""
        return replace(self, q=[displacement[subdomain.node_ids].ravel() for subdomain in subdomains])


def collect_states(problem: WeightedProblem, states: Sequence[FrameState]) -> list[MeasuredState]:
    """Take up what an earlier run has measured, on owned subdomains; collective.

    Cameras of ``problem`` are weighted as they were. The list is empty where the subdomains are others: the next frame
    is searched for then.
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
    """Extrapolate the unknowns of two frames, in order of time, linearly to a third; free of communication.

    Both states are of the same subdomains.
    """
    share = (time - last.time) / (last.time - before.time)
    return [q + share * (q - q_before) for q, q_before in zip(last.q, before.q, strict=True)]


def write_frame(measurement: Measurement, record: FrameRecord, folder: SeriesFolder,
                writer: BackgroundWriter) -> MeasuredState:
    """Begin to write a frame that was measured; collective, only rank 0 touches the disk.

    Returns what the next frame starts from, as it is written. Raises OSError on all ranks where the frame before could
    not be written.
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

    What the error brings is written as the result of a pair that did not converge.
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
