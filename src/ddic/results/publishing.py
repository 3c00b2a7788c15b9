"""How a measurement leaves the program: one protocol, whatever it is made of."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ddic.io import result_schema as schema
from ddic.io.replace_on_exit import NewFiles
from ddic.io.result_reader import Result
from ddic.io.result_writer import ResultWriter
from ddic.parallel.team import Team, require_held
from ddic.results.phase_times import PhaseTimes
from ddic.results.provenance import collect_provenance

T = TypeVar("T")


class Publishable(Protocol):
    """What a measurement does to be read by others; every call is collective.

    A method without subdomains or a mesh writes what it has: images, tables, attributes.
    """

    @property
    def team(self) -> Team:
        """All ranks."""
        ...

    def write(self, writer: ResultWriter | None) -> None:
        """Write everything that was measured.

        Parameters
        ----------
        writer : ResultWriter or None
            Open on rank 0, None elsewhere.
        """
        ...

    def describe_origin(self) -> dict[str, str | int]:
        """Say what it was measured from.

        Returns
        -------
        dict
            Images and sizes, by name; on rank 0.
        """
        ...

    def at(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Interpolate the displacement.

        Parameters
        ----------
        points : (n, 2) array
            Where, pixels.

        Returns
        -------
        (n, 2) array
            Pixels; nan where nothing was measured.
        """
        ...


@dataclass(frozen=True)
class Destination:
    """Where a result goes.

    Attributes
    ----------
    path : Path or None
        The file; None for memory.
    flip_y : bool
        Whether y points up in it.
    times : PhaseTimes or None
        Of the phases so far, for the file's history.
    noise_floor : float
        RMS displacement that the images' noise leaves, pixels; nan where it is not known.
    """

    path: Path | None
    flip_y: bool = False
    times: PhaseTimes | None = None
    noise_floor: float = float("nan")


def publish(measurement: Publishable, destination: Destination, files: NewFiles | None = None) -> None:
    """Write a result file; collective, only rank 0 touches the disk.

    Parameters
    ----------
    measurement : Publishable
        What was measured.
    destination : Destination
        Where it goes.
    files : NewFiles, optional
        Of rank 0, with which it takes its name there; by default it does so by itself.

    Raises
    ------
    OSError
        Where it cannot be written, on all ranks.
    """
    _write(measurement, destination, lambda _: None, files)


def gather(measurement: Publishable) -> Result:
    """Bring a whole measurement together; collective.

    Parameters
    ----------
    measurement : Publishable
        What was measured.

    Returns
    -------
    Result
        As a result file would hold it, in memory, on every rank.
    """
    return measurement.team.broadcast(_write(measurement, Destination(None), ResultWriter.read_back))


def pack(measurement: Publishable, destination: Destination, add: Callable[[ResultWriter], None]) -> bytes | None:
    """Make a result file in memory, for somebody else to write; collective.

    Parameters
    ----------
    measurement : Publishable
        What was measured.
    destination : Destination
        How it is written; its path is not looked at.
    add : callable
        Writes what else belongs in the file, on rank 0.

    Returns
    -------
    bytes or None
        Content of the file, on rank 0.
    """
    def finish(writer: ResultWriter) -> bytes:
        add(writer)
        return writer.read_image()

    return _write(measurement, replace(destination, path=None), finish)


def _write(measurement: Publishable, destination: Destination, take: Callable[[ResultWriter], T],
           files: NewFiles | None = None) -> T | None:
    """Write a measurement; what fails on rank 0, a full disk, say, is raised on all ranks, and leaves no file."""
    team = measurement.team
    with ExitStack() as stack:
        writer = team.build_on_root(
            lambda: stack.enter_context(ResultWriter(destination.path, flip_y=destination.flip_y, files=files)))
        measurement.write(writer)

        def finish() -> T:
            opened = require_held(writer)
            if destination.times is not None:
                _write_times(opened, destination.times)
            if not math.isnan(destination.noise_floor):
                opened.write_attributes(schema.CASE, {schema.NOISE_FLOOR: destination.noise_floor})
            opened.write_attributes(schema.PROVENANCE, collect_provenance(measurement.describe_origin()))
            return take(opened)

        result = team.build_on_root(finish)
        # Closing writes as well: what is left in HDF5's cache, then the file's name.
        team.build_on_root(stack.pop_all().close)
        return result


def _write_times(writer: ResultWriter, times: PhaseTimes) -> None:
    writer.write_table(schema.PHASES, {
        "phase": [str(phase) for phase in times.seconds],
        "seconds": list(times.seconds.values()),
        "cpu_seconds": list(times.cpu_seconds.values()),
        "imbalance": list(times.imbalance.values()),
    })
