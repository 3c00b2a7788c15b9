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

N_SUBDOMAINS = 4
"""As in the examples: as many as the largest number of ranks."""


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
    module = load_example(Path(example))
    settings = json.loads(sections)
    cut = {} if method == "monolithic" else {"subdomains": N_SUBDOMAINS}
    settings["solver"] = {**settings.get("solver", {}), "method": method, **cut}
    options = ddic.Options(settings, module.kinematics)
    result = ddic.measure(module.IMAGES, module.MESH, options=options)
    if MPI.COMM_WORLD.rank == 0:
        np.save(output, result.displacement)


main(*sys.argv[1:])
