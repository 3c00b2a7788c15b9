"""The MPI part of ``accept.kinematics``: measures as an example does, by a method, and keeps the displacement.

Usage: kinematics_job EXAMPLE METHOD SECTIONS OUTPUT; SECTIONS is a JSON object of further sections of a case.
"""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
from mpi4py import MPI

import ddic

SUBDOMAINS = 5
"""More than ranks, so that the partition is the same on any number of them."""


def load_example(path: Path) -> ModuleType:
    """Import an example, whose own measurement is not run.

    Parameters
    ----------
    path : Path
        Its file.

    Returns
    -------
    module
        With IMAGES, MESH and a function ``kinematics``.
    """
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} cannot be imported")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def main(example: str, method: str, sections: str, output: str) -> None:
    """Measure on all ranks; rank 0 writes.

    Parameters
    ----------
    example, method, sections, output : str
        Of the command line.
    """
    page = load_example(Path(example))
    settings = json.loads(sections)
    settings["solver"]["method"] = method
    if method != "monolithic":
        settings["solver"]["subdomains"] = SUBDOMAINS
    result = ddic.measure(page.IMAGES, page.MESH, options=ddic.Options(settings, page.kinematics))
    if MPI.COMM_WORLD.rank == 0:
        np.save(output, result.displacement)


main(*sys.argv[1:])
