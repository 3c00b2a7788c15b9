"""How to measure: settings as a case file has them, own kinematics, the ranks."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from ddic.case.loader import LoadedCase, convert_shorthand, convert_to_case
from ddic.case.schema import Case
from ddic.check.case import check_case, load_checked_case
from ddic.errors import InputError
from ddic.io.input_file import as_path
from ddic.kinematics.kinematics import RegionKinematics
from ddic.mesh.mesh import Mesh
from ddic.parallel.team import Team

ChooseKinematics = Callable[[Mesh], RegionKinematics]
"""From the whole mesh, repaired, to its kinematics."""

_NO_PATH = "in memory"
_IN_MEMORY = {
    "images": ("pixel_size", "length_unit", "reference_time", "deformed_time", "noise", "at_rest"),
    "mesh": ("mapping",),
    "output": ("residual_image", "flip_y", "uncertainty"),
}
"""Keys that settings may hold of the sections for which arguments stand."""


@dataclass(frozen=True, eq=False)
class Options:
    """How to measure.

    Attributes
    ----------
    settings : mapping
        Sections and keys of a case file, such as ``{"regularization": {"cut_off_wavelength": 60}}``.
    kinematics : callable, optional
        From the mesh to its kinematics; by default the unknowns are the displacements of the nodes.
    comm : mpi4py.MPI.Comm, optional
        The ranks that measure together; by default all that were started.
    """

    settings: Mapping[str, Any] = field(default_factory=dict)
    kinematics: ChooseKinematics | None = None
    comm: MPI.Comm | None = None


def choose_options(options: Options | Mapping[str, Any] | None) -> Options:
    """Look at the options that the user gave, or at the settings; raises InputError where they are of another type."""
    chosen = options if isinstance(options, Options) else Options({} if options is None else options)
    if not isinstance(chosen.settings, Mapping):
        raise InputError(f"options: {type(chosen.settings).__name__} given; give sections and keys of a case file, "
                         'such as {"regularization": {"cut_off_wavelength": 60}}, or ddic.Options')
    if chosen.comm is not None and not isinstance(chosen.comm, MPI.Comm):
        raise InputError(f"options: comm is of type {type(chosen.comm).__name__}; give a communicator of mpi4py")
    if chosen.kinematics is not None and not callable(chosen.kinematics):
        raise InputError(f"options: kinematics is of type {type(chosen.kinematics).__name__}; give a function that "
                         "makes it of the mesh, such as lambda mesh: ddic.LinearRegion(mesh, matrix)")
    return chosen


def choose_team(options: Options | Mapping[str, Any] | None) -> Team:
    """Choose the ranks that measure together: those that options name, or all."""
    if isinstance(options, Options) and isinstance(options.comm, MPI.Comm):
        return Team(options.comm)
    return Team.world()


def check_kinematics(kinematics: ChooseKinematics | None) -> ChooseKinematics | None:
    """Make a function that calls the user's and refuses what it returns, where that is no kinematics of the mesh."""
    if kinematics is None:
        return None

    def choose(mesh: Mesh) -> RegionKinematics:
        found = kinematics(mesh)
        if not isinstance(found, RegionKinematics):
            raise InputError(f"kinematics: the function returned {type(found).__name__}; return a "
                             "ddic.RegionKinematics, such as ddic.LinearRegion")
        # One made beforehand will do, where repairing has changed nothing.
        same = np.array_equal(found.mesh.nodes, mesh.nodes) and np.array_equal(found.mesh.cells, mesh.cells)
        if not same:
            raise InputError("kinematics: made of another mesh; make it of the one that the function is given, whose "
                             "nodes may be numbered anew")
        return found

    return choose


def load_given_case(source: object, place: Path, n_ranks: int, output: Path | None = None) -> LoadedCase:
    """Load a case file, or take a case that is in memory, and check it all; ``place`` stands for the latter's file.

    ``output`` takes the place of the result file that the case names. Raises InputError with a line for each problem.
    """
    if not isinstance(source, Case | LoadedCase):
        return load_checked_case(as_path(source, "case"), n_ranks, output)
    loaded = LoadedCase(source, place, "") if isinstance(source, Case) else source
    if output is not None:
        loaded = loaded.with_output(output)
    check_case(loaded, n_ranks)
    return loaded


def make_case(settings: Mapping[str, Any]) -> Case:
    """Make a case of settings, sections and keys of a case file; what else such a file holds is in memory.

    Raises InputError with a line for each unknown key, wrong type and impossible value.
    """
    try:
        data: dict[str, Any] = convert_shorthand(json.loads(json.dumps(dict(settings), default=_plain)))
    except TypeError as error:
        raise InputError(f"options: {error}") from error
    _refuse_what_arguments_say(data)
    return convert_to_case(_complete(data), "options")


def _refuse_what_arguments_say(data: Mapping[str, Any]) -> None:
    for name, keys in _IN_MEMORY.items():
        given = data.get(name)
        # Elements of a pixel are too many for a mesh in memory.
        known = (*keys, "structured") if name == "mesh" and "pgd" in data else keys
        # Of another type it is a mistake that the schema tells.
        unknown = [key for key in given if key not in known] if isinstance(given, dict) else []
        if unknown:
            listed = ", ".join(f"{name}.{key}" for key in known)
            raise InputError(f"options: {name}.{unknown[0]} is for case files; give what it says as an argument. Valid "
                             f"here: {listed}")
    if "near" in data:
        raise InputError("options: near fields need a case; measure a case file, or prepare one and measure its frames")


def _complete(data: Mapping[str, Any]) -> dict[str, Any]:
    """Settings with names in place of the files that a case must name."""
    images, mesh = data.get("images", {}), data.get("mesh", {})
    return {
        **data,
        "images": {"reference": _NO_PATH, "deformed": _NO_PATH, **images} if isinstance(images, dict) else images,
        "mesh": {"file": "mesh", **mesh} if isinstance(mesh, dict) and "structured" not in mesh else mesh,
    }


def _plain(value: object) -> object:
    """Stand in for what JSON does not know: numpy's numbers and arrays, paths, other mappings."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"a value of type {type(value).__name__}; give numbers, texts, lists and mappings")
