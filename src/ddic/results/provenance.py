"""Where a result comes from: images, versions, commit, command."""

from __future__ import annotations

import hashlib
import platform
import sys
from datetime import UTC, datetime
from functools import cache, lru_cache
from importlib import metadata
from pathlib import Path

import mpi4py.MPI
import numpy as np
import petsc4py.PETSc

from ddic.images.source import ImageSource
from ddic.images.window import Window
from ddic.io.image_file import compute_sha256
from ddic.io.input_file import find_source_commit
from ddic.version import __version__

_LIBRARIES = ("numpy", "scipy", "numba", "h5py", "mpi4py", "petsc4py")


def collect_provenance(origin: dict[str, str | int]) -> dict[str, str | int]:
    """Collect the facts that let a reader repeat a measurement; on rank 0.

    Parameters
    ----------
    origin : dict
        What it was measured from.

    Returns
    -------
    dict
        Date, command, versions, then what was given.
    """
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
    """Describe an image by its path, size and checksum.

    Parameters
    ----------
    name : str
        What the image is.
    image : ImageSource
        From a file, or in memory.

    Returns
    -------
    dict
        NAME_path, NAME_size and NAME_sha256: of the file's bytes, or of the pixels in memory.
    """
    if image.path.is_file():
        status = image.path.stat()
        checksum = _compute_checksum(image.path, status.st_size, status.st_mtime_ns)
    else:
        pixels = image.read(Window(0, 0, image.width, image.height))
        checksum = hashlib.sha256(np.ascontiguousarray(pixels).tobytes()).hexdigest()
    return {f"{name}_path": str(image.path), f"{name}_size": f"{image.width}x{image.height}",
            f"{name}_sha256": checksum}
