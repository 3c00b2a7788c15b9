"""Where a result comes from: images, versions, commit, command."""

from __future__ import annotations

import platform
import sys
from datetime import UTC, datetime
from importlib import metadata

import mpi4py.MPI
import petsc4py.PETSc

import ddic
from ddic.images.source import ImageSource
from ddic.io.image_file import sha256_of_file
from ddic.io.source_tree import source_commit

_LIBRARIES = ("numpy", "scipy", "numba", "h5py", "mpi4py", "petsc4py")


def provenance(reference: ImageSource, deformed: ImageSource, *, n_ranks: int,
               n_subdomains: int) -> dict[str, str | int]:
    """Facts that let a reader repeat the measurement; called on rank 0."""
    facts: dict[str, str | int] = {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": " ".join(sys.argv),
        "ddic": ddic.__version__,
        "commit": source_commit(),
        "python": platform.python_version(),
        "petsc": ".".join(str(n) for n in petsc4py.PETSc.Sys.getVersion()),
        "mpi": mpi4py.MPI.Get_library_version().splitlines()[0].strip("\0 "),
        "n_ranks": n_ranks,
        "n_subdomains": n_subdomains,
    }
    for library in _LIBRARIES:
        facts[library] = metadata.version(library)
    return {**facts, **image_attributes("reference", reference), **image_attributes("deformed", deformed)}


def image_attributes(name: str, image: ImageSource) -> dict[str, str | int]:
    """An image's path, size and checksum under NAME_path, NAME_size and NAME_sha256."""
    return {f"{name}_path": str(image.path), f"{name}_size": f"{image.width}x{image.height}",
            f"{name}_sha256": sha256_of_file(image.path)}
