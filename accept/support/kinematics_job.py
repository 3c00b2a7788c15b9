"""The MPI part of ``accept.kinematics``: measures with an example's images, mesh and kinematics, by a method.

Usage: kinematics_job EXAMPLE METHOD SECTIONS OUTPUT; SECTIONS is a JSON object of further sections of a case, OUTPUT
the file that takes the displacement of all nodes.
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

SUBDOMAINS = 4
"""As many as there are ranks at most."""


def load_example(path: Path) -> ModuleType:
    """Import an example, whose own measurement is not run.

    Parameters
    ----------
    path : Path
        Its file.

    Returns
    -------
    module
        With ``IMAGES``, ``MESH`` and ``kinematics``.
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
    chosen = load_example(Path(example))
    settings = json.loads(sections)
    settings["solver"] |= {"method": method}
    if method != "monolithic":
        settings["solver"] |= {"subdomains": SUBDOMAINS}
    result = ddic.measure(chosen.IMAGES, chosen.MESH, options=ddic.Options(settings, chosen.kinematics))
    if MPI.COMM_WORLD.rank == 0:
        np.save(output, result.displacement)


main(*sys.argv[1:])
