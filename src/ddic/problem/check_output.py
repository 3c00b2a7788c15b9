"""Whether the result can be written where a case wants it."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from tempfile import TemporaryFile

from ddic.case.frame_files import list_deformed
from ddic.case.loader import LoadedCase
from ddic.case.schema import Case, ImagesSection, MeshSection, NearSection
from ddic.errors import InputError
from ddic.io.input_file import find_real_path, is_readable_file
from ddic.io.result_schema import earlier_path, not_converged_path, physical_path, sidecar_path, summary_path

ROOM_IN_NAME = 48
"""Bytes that names of files beside the result are longer by, those under construction among them:
``.NAME.not_converged.near_1.residual.vtkhdf.PID.tmp`` less the result's own ending."""


def check_output(loaded: LoadedCase) -> None:
    """Check that the result and what stands beside it can be written and overwrite no input.

    Parameters
    ----------
    loaded : LoadedCase
        The case file.

    Raises
    ------
    InputError
        At the first problem.
    """
    case = loaded.case
    check_output_file(case.output.file)
    if case.output.file.suffix == ".json":
        raise InputError(f"output.file: {case.output.file} is the name of the summary that is written beside the "
                         "result; choose another ending, such as .vtkhdf")
    _check_nothing_is_overwritten(loaded)


def check_output_file(file: Path) -> None:
    """Check that a file can be written.

    Parameters
    ----------
    file : Path
        The result file.

    Raises
    ------
    InputError
        Where it is a folder, or its folder is not there or cannot be written to.
    """
    folder = file.parent
    try:
        if file.is_dir():
            raise InputError(f"output.file: {file} is a folder; give the name of a file")
        if file.exists() and not file.is_file():
            raise InputError(f"output.file: {file} is a device or a pipe; give the name of a file")
        if not folder.is_dir():
            raise InputError(f"output.file: there is no folder {folder}; make it first")
        longest = os.pathconf(folder, "PC_NAME_MAX")
        if len(os.fsencode(file.name)) > longest - ROOM_IN_NAME:
            raise InputError(f"output.file: {file.name} is too long a name: the file system takes {longest} bytes, of "
                             f"which files beside it need {ROOM_IN_NAME}; shorten it")
        # Rights alone do not tell: some folders are no places for files.
        with TemporaryFile(dir=folder):
            pass
    except (OSError, ValueError) as error:
        reason = (isinstance(error, OSError) and error.strerror) or error
        raise InputError(f"output.file: the folder {folder} cannot be written to ({reason}); choose another") from error


def _check_nothing_is_overwritten(loaded: LoadedCase) -> None:
    result = loaded.case.output.file
    n_cameras = 1 + len(loaded.case.near)
    written = {path for name in (result, not_converged_path(result), earlier_path(result))
               for path in (name, summary_path(name), physical_path(name),
                            *(sidecar_path(name, camera) for camera in range(n_cameras)))}
    resolved = {find_real_path(path) for path in written}
    existing = [path for path in written if path.exists()]
    for path in list_inputs(loaded):
        if path is not None and (find_real_path(path) in resolved or _is_any(path, existing)):
            raise InputError(f"output.file: {result} would overwrite the input {path}; choose another name")


def _is_any(path: Path, others: Iterable[Path]) -> bool:
    """Whether a file is one of others by another name, a hard link for instance."""
    return is_readable_file(path) and any(path.samefile(other) for other in others)


def list_inputs(loaded: LoadedCase) -> Iterator[Path | None]:
    """List the files that a case reads and no run replaces.

    Parameters
    ----------
    loaded : LoadedCase
        The case file.

    Yields
    ------
    Path or None
        The case file and what it names; None for each that it does not.
    """
    yield loaded.path
    yield from list_named_files(loaded.case)


def list_named_files(case: Case) -> Iterator[Path | None]:
    """List the files that a case names and no run replaces.

    Parameters
    ----------
    case : Case
        Any.

    Yields
    ------
    Path or None
        None for each that it does not name.
    """
    yield from _list_images(case.images)
    yield case.images.at_rest
    yield case.solver.partition_file
    yield case.start.from_points
    yield from _list_mesh_files(case.mesh)
    for near in case.near:
        if near.mesh is not None:
            yield from _list_mesh_files(near.mesh)
    for near in case.near:
        yield from _list_images(near)
        yield near.mapping_file


def _list_images(images: ImagesSection | NearSection) -> Iterator[Path | None]:
    yield images.reference
    yield from list_deformed(images)
    yield images.reference_mask
    yield images.deformed_mask


def _list_mesh_files(mesh: MeshSection) -> Iterator[Path | None]:
    yield mesh.file
    if mesh.structured is not None:
        yield mesh.structured.mask
