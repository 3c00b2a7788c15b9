"""What a method measured, whatever it is made of: the seam by which it is written, summed up and started from.

How it leaves the program, to a file or to memory; where a result comes from: images, versions, commit, command.
"""

import hashlib
import platform
import sys
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from datetime import UTC, datetime
from functools import cache, lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any, Protocol, TypeVar, runtime_checkable

import mpi4py.MPI
import numpy as np
import petsc4py.PETSc

from ddic.functionals.grey_statistics import GreyCorrection
from ddic.images.source import ImageSource
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs
from ddic.io import result_schema as schema
from ddic.io.image_file import compute_sha256
from ddic.io.input_file import FileStamps, Stamp, find_source_commit
from ddic.io.replace_on_exit import NewFiles
from ddic.io.result_reader import Result
from ddic.io.result_writer import ResultWriter
from ddic.io.volume_file import VolumeFile
from ddic.parallel.team import Team, require_held
from ddic.problem.weighted_problem import ProblemSize
from ddic.results.summary import Summary
from ddic.version import __version__

T = TypeVar("T")


@runtime_checkable
class Publishable(Protocol):
    """What a method measured, and what it does to be read by others; every call is collective.

    A method without subdomains or a mesh writes what it has: images, tables, attributes.
    """

    @property
    def team(self) -> Team:
        """All ranks."""

    @property
    def inputs(self) -> Inputs:
        """Reference images and settings."""

    @property
    def frame(self) -> Frame:
        """The deformed images."""

    @property
    def size(self) -> ProblemSize:
        """Sizes and weights."""

    @property
    def unknowns(self) -> Any:
        """What the session that measured it may start another frame from."""

    @property
    def grey_correction(self) -> GreyCorrection:
        """What was corrected of grey levels."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know."""

    @property
    def failure(self) -> str:
        """Why it is no result; empty where it converged."""

    @property
    def verdict(self) -> schema.Verdict:
        """Whether it can be trusted."""

    def write(self, writer: ResultWriter | None) -> None:
        """Write everything that was measured; the writer is open on rank 0, None elsewhere."""

    def describe_origin(self) -> dict[str, str | int]:
        """Say what it was measured from: images and sizes, by name."""

    def summarize(self, of_run: dict[str, Any]) -> Summary:
        """Sum it up, alike on all ranks; ``of_run`` is what is told of any method, by field of the summary."""


def write_case(measured: Publishable, writer: ResultWriter, of_method: dict[str, Any]) -> None:
    """Write the case with what a method has to say beside it, and the times and units; on rank 0."""
    inputs, size = measured.inputs, measured.size
    images = inputs.case.imaging
    writer.write_attributes(schema.CASE, {
        "path": str(inputs.case_path), "toml": inputs.case_text, "json": inputs.asked_case.model_dump_json(),
        "eta": size.eta, **of_method,
    })
    writer.write_attributes(schema.TIME, {"reference": images.reference_time, "deformed": images.deformed_time})
    writer.write_attributes(schema.UNITS, {"pixel_size": images.pixel_size or 1.0, "length_unit": images.length_unit})
    if size.half_amplitudes is not None:
        writer.write_attributes(schema.CASE, {"half_amplitude_shear_px": size.half_amplitudes.shear,
                                              "half_amplitude_longitudinal_px": size.half_amplitudes.longitudinal})


_LIBRARIES = ("numpy", "scipy", "numba", "h5py", "mpi4py", "petsc4py")


@cache
def _collect_versions() -> dict[str, str | int]:
    """Versions of what runs; looked up once a process, as each frame of a series asks."""
    return {
        "ddic": __version__,
        "commit": find_source_commit(),
        "python": platform.python_version(),
        "petsc": ".".join(str(n) for n in petsc4py.PETSc.Sys.getVersion()),
        "mpi": mpi4py.MPI.Get_library_version().splitlines()[0].strip("\0 "),
        **{library: metadata.version(library) for library in _LIBRARIES},
    }


@lru_cache(maxsize=8)
def _compute_checksum(stamps: tuple[tuple[Path, Stamp], ...]) -> str:
    """SHA-256 of files as long as they stay the same: each frame of a series names the reference image again.

    Of several it is that of the lines that the program sha256sum writes of them.
    """
    sums = [(compute_sha256(path), path.name) for path, _ in stamps]
    lines = "".join(f"{checksum}  {name}\n" for checksum, name in sums)
    return sums[0][0] if len(sums) == 1 else hashlib.sha256(lines.encode()).hexdigest()


def describe_image(name: str, image: ImageSource) -> dict[str, str | int]:
    """Describe an image by NAME_path, NAME_size and NAME_sha256: of its files' bytes, or of the pixels in memory."""
    if image.path.is_file() or isinstance(image, VolumeFile):
        checksum = _compute_checksum(tuple(FileStamps.take([image.path]).stamps.items()))
    else:
        pixels = image.read(image.extent)
        checksum = hashlib.sha256(np.ascontiguousarray(pixels).data).hexdigest()
    return {f"{name}_path": str(image.path), f"{name}_size": "x".join(map(str, image.extent.sizes)),
            f"{name}_sha256": checksum}


def describe_images(team: Team, images: Mapping[str, ImageSource]) -> dict[str, str | int]:
    """Describe images as ``describe_image`` does, each on a rank of its own, for checksums take seconds; collective."""
    owners = [k * team.size // len(images) for k in range(len(images))]
    mine = team.together(lambda: [describe_image(name, image) for (name, image), owner
                                  in zip(images.items(), owners, strict=True) if owner == team.rank])
    return {key: value for described in team.gather_lists(mine) for key, value in described.items()}


Add = Callable[[ResultWriter], None]
"""Writes on rank 0 what else belongs in a result file."""


def publish(measurement: Publishable, path: Path, files: NewFiles | None = None, *, flip_y: bool = False,
            add: Add = lambda writer: None) -> None:
    """Write a result file; collective, only rank 0 touches the disk.

    It takes its name with ``files`` of rank 0, by default by itself; with ``flip_y`` y points up in it. Raises OSError
    on all ranks where it cannot be written.
    """
    _write(measurement, path, add, flip_y=flip_y, files=files)


def gather(measurement: Publishable) -> Result:
    """Bring a whole measurement together as a result file would hold it, in memory, on every rank; collective."""
    return measurement.team.broadcast(_write(measurement, None, ResultWriter.read_back))


def pack(measurement: Publishable, *, flip_y: bool, add: Add) -> bytes | None:
    """Make the content of a result file, on rank 0, for somebody else to write; collective."""
    def finish(writer: ResultWriter) -> bytes:
        add(writer)
        return writer.read_image()

    return _write(measurement, None, finish, flip_y=flip_y)


def _write(measurement: Publishable, path: Path | None, take: Callable[[ResultWriter], T], *, flip_y: bool = False,
           files: NewFiles | None = None) -> T | None:
    """Write a measurement, in memory without a path; an error of rank 0, raised on all, leaves no file; collective."""
    team = measurement.team
    with ExitStack() as stack:
        writer = team.build_on_root(lambda: stack.enter_context(ResultWriter(path, flip_y=flip_y, files=files)))
        measurement.write(writer)

        origin = measurement.describe_origin()

        def finish() -> T:
            opened = require_held(writer)
            # What lets a reader repeat the measurement.
            now, command = datetime.now(UTC).isoformat(timespec="seconds"), " ".join(sys.argv)
            opened.write_attributes(schema.PROVENANCE, {"date": now, "command": command, **_collect_versions(),
                                                        **origin})
            return take(opened)

        result = team.build_on_root(finish)
        # Closing writes as well: what is left in HDF5's cache, then the file's name.
        team.build_on_root(stack.pop_all().close)
        return result
