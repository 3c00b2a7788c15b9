"""What is told of the frames of a series: each in a line, all in the summary."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ddic.io.replace_on_exit import NewFiles
from ddic.io.text_files import convert_to_json, write_json

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
