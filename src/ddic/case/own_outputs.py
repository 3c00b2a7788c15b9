"""Outputs that replace nothing but earlier outputs of the same kind: never an input, by whatever name or link."""

import errno
import mmap
import os
import stat
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from ddic.case.loader import LoadedCase
from ddic.case.named_files import find_matches, is_pattern, list_named_files
from ddic.case.schema import Case
from ddic.errors import InputError
from ddic.io import result_schema
from ddic.io.input_file import find_real_path, is_readable_file, list_parts
from ddic.io.text_files import read_text

LONGEST_CASE = 1 << 20
"""Bytes of a TOML file that is read as a possible case file; longer ones are none."""


@dataclass(frozen=True)
class OutputKind:
    """How files of a kind that ddic writes are known.

    Attributes
    ----------
    what : str
        Its name in messages.
    beginnings : tuple of bytes
        One of them stands first.
    holds : bytes
        Or this is somewhere in it; empty where nothing is.
    """

    what: str
    beginnings: tuple[bytes, ...]
    holds: bytes = b""


PICTURE = OutputKind("picture", (b"GIF8", b"\0\0\0\x20ftyp", b"\0\0\0\x1cftyp"), b"Matplotlib")
PAGE = OutputKind("report", (b"<!DOCTYPE html>",))
MAPPING = OutputKind("mapping", (b"# Near camera: homography",))
OPENINGS = OutputKind("table of openings", (b"line,distance_px,",))
PROBES = OutputKind("table of probes", (b"time,result,probe,",))
NODES, CELLS = OutputKind("table of nodes", (b"node,x [px],",)), OutputKind("table of cells", (b"cell,x [px],",))
VTU = OutputKind("VTU file", (), b"written by ddic export")
TRIALS = OutputKind("table of trials", (b"element_size_px,",))
MESH = OutputKind("mesh", (), b"written by ddic mesh")
UNCERTAINTY = OutputKind("table of uncertainty", (b"kind,element_size_px,",))


def require_own_output(path: Path, kind: OutputKind, inputs: Iterable[Path | None] = ()) -> None:
    """Refuse an output that would replace anything but an earlier output of its kind, before anything is computed.

    ``inputs`` is what the command reads, None for each that is not given. Raises InputError where the output is an
    input of the command or of a case file nearby, a device or another's file, through links too.
    """
    require_no_input(path, inputs)
    if path.is_file() and path.stat().st_size and not _is_own(path, kind):
        raise InputError(f"{path}: is there already, and no {kind.what} that ddic wrote; remove it, or choose another "
                         "--output")


def require_no_input(path: Path, inputs: Iterable[Path | None] = ()) -> None:
    """Refuse an output that is no plain file, or an input of the command or of a case file beside or above it.

    ``inputs`` is what the command reads, None for each that is not given. Raises InputError where it would not stay as
    it is.
    """
    try:
        mode = path.stat().st_mode
    except OSError:
        return
    if not stat.S_ISREG(mode):
        what = "a folder" if stat.S_ISDIR(mode) else "a device or a pipe"
        raise InputError(f"{path}: is {what}; give the name of a file")
    lost = _find_lost(inputs, [path])
    if lost is not None:
        raise InputError(f"{path}: would overwrite the input {lost}; choose another output")
    for case_file in _list_toml_files(path):
        lost = _find_lost(_list_texts_of_files(case_file), [path])
        if lost is not None:
            raise InputError(f"{path}: would overwrite {lost}, an input of {case_file}; choose another output")


def _is_own(path: Path, kind: OutputKind) -> bool:
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
        begins = any(content[:len(beginning)] == beginning for beginning in kind.beginnings)
        return begins or (bool(kind.holds) and content.find(kind.holds) >= 0)


def _list_toml_files(path: Path) -> list[Path]:
    """TOML files beside a file and in the folder above, where case files stand."""
    folder = path.absolute().parent
    return [found for where in (folder, folder.parent) for found in sorted(where.glob("*.toml"))]


def _list_texts_of_files(case_file: Path) -> Iterator[Path]:
    """What a TOML file, a case or not, may name: every text but in what it has written, and files that match it."""
    try:
        if case_file.stat().st_size > LONGEST_CASE:
            return
        content = tomllib.loads(read_text(case_file, "case file", "check the path"))
    except (InputError, OSError, ValueError, RecursionError):
        return
    volumes = [*_list_texts(content.get("volumes"))]
    for text in _list_texts({key: value for key, value in content.items() if key != "output"}):
        if not text or "\0" in text or "\n" in text:
            continue
        named = case_file.parent / text
        # Of folders the volumes alone are read.
        yield from (path for path in (find_matches(named) if is_pattern(named) else [named])
                    if text in volumes or not path.is_dir())


def _list_texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list):
        for item in value.values() if isinstance(value, dict) else value:
            yield from _list_texts(item)


ROOM_IN_NAME = 48
"""Bytes that names of files beside the result are longer by, those under construction among them:
``.NAME.not_converged.near_1.residual.vtkhdf.PID.tmp`` less the result's own ending."""


def check_output(loaded: LoadedCase) -> None:
    """Raise InputError where the result or what stands beside it cannot be written, or would overwrite an input."""
    case = loaded.case
    check_output_file(case.output.file)
    if case.output.file.suffix == ".json":
        raise InputError(f"output.file: {case.output.file} is the name of the summary that is written beside the "
                         "result; choose another ending, such as .vtkhdf")
    # What stands for the file of a case in memory is a folder.
    check_nothing_is_overwritten(case.output.file, case, [path for path in [loaded.path] if is_readable_file(path)])


def check_output_file(file: Path) -> None:
    """Raise InputError where a file cannot be written: a folder, a link in circles, or of a folder that is closed."""
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
    replaced = [*_list_company(result, n_cameras), *_list_company(result_schema.earlier_path(result), n_cameras)]
    last_field = _list_company(result_schema.not_converged_path(result), n_cameras)
    # Of folders volumes alone are read.
    named = [path for path in list_named_files(case, Path()) if case.dim == 3 or not os.path.isdir(path)]
    inputs = [*others, *(path for path in named if path != start)]
    frames = find_real_path(result_schema.frames_path(result))
    lost = _find_lost(inputs, [*replaced, *last_field], frames) or _find_lost({start} & {*named}, replaced, frames)
    if lost is not None:
        raise InputError(f"{key}: {result} would overwrite the input {lost}; choose another name")


def _list_company(result: Path, n_cameras: int) -> list[Path]:
    """A result file and what stands beside it."""
    sidecars = (result_schema.sidecar_path(result, camera) for camera in range(n_cameras))
    return [result, result_schema.summary_path(result), result_schema.physical_path(result), *sidecars]


def _find_lost(inputs: Iterable[Path | None], written: Iterable[Path], folder: Path | None = None) -> Path | None:
    """The first input in a folder, or one of the files to be written, by another name too: a hard link for instance.

    Nothing is written into a folder that is an input.
    """
    places = {find_real_path(path) for path in written}
    existing = [path for path in places if is_readable_file(path)]
    folders = {parent for path in places for parent in path.parents}
    for path in inputs:
        if path is None:
            continue
        for part in {path: None, **dict.fromkeys(list_parts(path))}:
            real = find_real_path(part)
            if real in places or real in folders or (folder is not None and folder in real.parents):
                return part
            if is_readable_file(part) and any(part.samefile(other) for other in existing):
                return part
    return None
