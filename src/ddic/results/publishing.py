"""How a measurement leaves the program, whatever it is made of: to a file, or to memory.

Where a result comes from: images, versions, commit, command.

Seconds by phase over all ranks.
"""

import hashlib
import math
import platform
import sys
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cache, lru_cache
from importlib import metadata
from pathlib import Path
from typing import TypeVar

import mpi4py.MPI
import numpy as np
import petsc4py.PETSc

from ddic.images.source import ImageSource
from ddic.images.window import Window
from ddic.io import result_schema as schema
from ddic.io.image_file import compute_sha256
from ddic.io.input_file import find_source_commit
from ddic.io.replace_on_exit import NewFiles
from ddic.io.result_reader import Result
from ddic.io.result_writer import ResultWriter
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team, require_held
from ddic.results.publishable import Publishable
from ddic.version import __version__

_LIBRARIES = ("numpy", "scipy", "numba", "h5py", "mpi4py", "petsc4py")


def collect_provenance(origin: dict[str, str | int]) -> dict[str, str | int]:
    """Collect the facts that let a reader repeat a measurement: date, command, versions, then ``origin``; on rank 0."""
    return {"date": datetime.now(UTC).isoformat(timespec="seconds"), "command": " ".join(sys.argv),
            **_collect_versions(), **origin}


@cache
def _collect_versions() -> dict[str, str | int]:
    """Versions of what runs; looked up once a process, as each frame of a series asks."""
    facts: dict[str, str | int] = {
        "ddic": __version__,
        "commit": find_source_commit(),
        "python": platform.python_version(),
        "petsc": ".".join(str(n) for n in petsc4py.PETSc.Sys.getVersion()),
        "mpi": mpi4py.MPI.Get_library_version().splitlines()[0].strip("\0 "),
    }
    for library in _LIBRARIES:
        facts[library] = metadata.version(library)
    return facts


@lru_cache(maxsize=8)
def _compute_checksum(path: Path, size: int, changed: int) -> str:
    """SHA-256 of a file as long as it stays the same: each frame of a series names the reference image again."""
    return compute_sha256(path)


def describe_image(name: str, image: ImageSource) -> dict[str, str | int]:
    """Describe an image by NAME_path, NAME_size and NAME_sha256: of the file's bytes, or of the pixels in memory."""
    if image.path.is_file():
        status = image.path.stat()
        checksum = _compute_checksum(image.path, status.st_size, status.st_mtime_ns)
    else:
        pixels = image.read(Window(0, 0, image.width, image.height))
        checksum = hashlib.sha256(np.ascontiguousarray(pixels).tobytes()).hexdigest()
    return {f"{name}_path": str(image.path), f"{name}_size": f"{image.width}x{image.height}",
            f"{name}_sha256": checksum}


@dataclass(frozen=True)
class PhaseTimes:
    """Seconds by phase, in the order in which phases began.

    Attributes
    ----------
    seconds : dict
        Wall seconds of the slowest rank.
    cpu_seconds : dict
        CPU seconds of all ranks.
    imbalance : dict
        Busy seconds of the busiest rank over their mean, from 1 (all have the same to do) to the number of ranks (one
        does it all). Busy are CPU seconds that are not spent in a team's communication; what a rank waits inside PETSc
        counts as busy.
    """

    seconds: dict[Phase, float]
    cpu_seconds: dict[Phase, float]
    imbalance: dict[Phase, float]


def gather_phase_times(team: Team, clock: PhaseClock) -> PhaseTimes:
    """Gather what the clocks of all ranks have so far, of the phases that this rank has had; collective."""
    clocks = team.gather_lists([(clock.wall, clock.cpu, clock.busy)])
    seconds, cpu_seconds, imbalance = {}, {}, {}
    for phase in clock.wall:
        seconds[phase] = max(wall.get(phase, 0.0) for wall, _, _ in clocks)
        cpu_seconds[phase] = sum(cpu.get(phase, 0.0) for _, cpu, _ in clocks)
        imbalance[phase] = _imbalance([busy.get(phase, 0.0) for _, _, busy in clocks])
    return PhaseTimes(seconds, cpu_seconds, imbalance)


def _imbalance(busy: list[float]) -> float:
    """Return the largest of the ranks' seconds over their mean, 1 where none has any."""
    mean = float(np.mean(busy))
    return max(busy) / mean if mean > 0 else 1.0


T = TypeVar("T")


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

    It takes its name with ``files`` of rank 0, by default by itself. Raises OSError on all ranks where it cannot be
    written.
    """
    _write(measurement, destination, lambda _: None, files)


def gather(measurement: Publishable) -> Result:
    """Bring a whole measurement together as a result file would hold it, in memory, on every rank; collective."""
    return measurement.team.broadcast(_write(measurement, Destination(None), ResultWriter.read_back))


def pack(measurement: Publishable, destination: Destination, add: Callable[[ResultWriter], None]) -> bytes | None:
    """Make the content of a result file, on rank 0, for somebody else to write; collective.

    The destination's path is not looked at; ``add`` writes what else belongs in the file, on rank 0.
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
