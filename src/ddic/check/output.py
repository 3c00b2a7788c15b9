"""Whether the result can be written where a case wants it."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from tempfile import TemporaryFile

from ddic.case.frame_files import list_deformed
from ddic.case.loader import LoadedCase
from ddic.case.schema import Case, ImagesSection, MeshSection, NearSection
from ddic.errors import InputError
from ddic.io.input_file import find_real_path, is_readable_file
from ddic.io.result_schema import (
    earlier_path,
    frames_path,
    not_converged_path,
    physical_path,
    sidecar_path,
    summary_path,
)

ROOM_IN_NAME = 48
"""Bytes that names of files beside the result are longer by, those under construction among them:
``.NAME.not_converged.near_1.residual.vtkhdf.PID.tmp`` less the result's own ending."""


def check_output(loaded: LoadedCase) -> None:
    """Check that the result and what stands beside it can be written and overwrite no input.

    Raises InputError at the first problem.
    """
    case = loaded.case
    check_output_file(case.output.file)
    if case.output.file.suffix == ".json":
        raise InputError(f"output.file: {case.output.file} is the name of the summary that is written beside the "
                         "result; choose another ending, such as .vtkhdf")
    check_nothing_is_overwritten(case.output.file, case, [loaded.path])


def check_output_file(file: Path) -> None:
    """Check that a file can be written.

    Raises InputError where it is a folder or a link in circles, or its folder is not there or cannot be written to.
    """
    folder = file.parent
    try:
        if _is_endless_link(file):
            raise InputError(f"output.file: {file} is a link that leads in circles; remove it, or give another name")
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


def _is_endless_link(path: Path) -> bool:
    try:
        path.stat()
    except OSError as error:
        return error.errno == errno.ELOOP
    return False


def check_nothing_is_overwritten(result: Path, case: Case, others: Iterable[Path | None] = (),
                                 key: str = "output.file") -> None:
    """Check that neither a result nor what stands beside it takes the place of an input.

    A case may go on from the field that it left when it did not converge: the next one replaces that. ``others`` are
    further inputs, None for each that is not given; ``key`` is where the result's name comes from, for the message.
    Raises InputError at the first input that would be lost.
    """
    start = case.start.from_result
    n_cameras = 1 + len(case.near)
    replaced = [*_list_company(result, n_cameras), *_list_company(earlier_path(result), n_cameras)]
    last_field = _list_company(not_converged_path(result), n_cameras)
    inputs = [*others, *(path for path in list_named_files(case) if path != start)]
    frames = find_real_path(frames_path(result))
    lost = _find_lost(inputs, [*replaced, *last_field], frames) or _find_lost([start], replaced, frames)
    if lost is not None:
        raise InputError(f"{key}: {result} would overwrite the input {lost}; choose another name")


def _list_company(result: Path, n_cameras: int) -> list[Path]:
    """A result file and what stands beside it."""
    sidecars = (sidecar_path(result, camera) for camera in range(n_cameras))
    return [result, summary_path(result), physical_path(result), *sidecars]


def _find_lost(inputs: Iterable[Path | None], written: Iterable[Path], folder: Path) -> Path | None:
    """The first input in a folder, or one of the files to be written, by another name too: a hard link for instance."""
    places = {find_real_path(path) for path in written}
    existing = [path for path in places if is_readable_file(path)]
    for path in inputs:
        if path is None:
            continue
        real = find_real_path(path)
        if real in places or folder in real.parents:
            return path
        if is_readable_file(path) and any(path.samefile(other) for other in existing):
            return path
    return None


def list_inputs(loaded: LoadedCase) -> Iterator[Path | None]:
    """List the files that a case reads and no run replaces, the case file too; None for each that it does not name."""
    yield loaded.path
    yield from list_named_files(loaded.case)


def list_named_files(case: Case) -> Iterator[Path | None]:
    """List the files that a case names and no run replaces; None for each that it does not name."""
    yield from _list_images(case.images)
    yield case.images.at_rest
    yield case.solver.partition_file
    yield case.start.from_points
    yield case.start.from_result
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
