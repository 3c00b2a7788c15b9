"""Outputs that replace nothing but earlier outputs of the same kind: never an input, by whatever name or link."""

from __future__ import annotations

import mmap
import os
import stat
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from glob import glob
from pathlib import Path
from typing import Any

from ddic.case.frame_files import PATTERN
from ddic.errors import InputError
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
TRIALS = OutputKind("table of trials", (b"element_size_px,",))
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
    for other in inputs:
        if other is not None and _is_same(path, other):
            raise InputError(f"{path}: would overwrite the input {other}; choose another output")
    for case_file in _list_toml_files(path):
        for other in _list_named_files(case_file):
            if _is_same(path, other):
                raise InputError(f"{path}: would overwrite {other}, an input of {case_file}; choose another output")


def _is_own(path: Path, kind: OutputKind) -> bool:
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
        begins = any(content[:len(beginning)] == beginning for beginning in kind.beginnings)
        return begins or (bool(kind.holds) and content.find(kind.holds) >= 0)


def _is_same(path: Path, other: Path) -> bool:
    try:
        return os.path.samefile(path, other)
    except (OSError, ValueError):
        return False


def _list_toml_files(path: Path) -> list[Path]:
    """TOML files beside a file and in the folder above, where case files stand."""
    folder = path.absolute().parent
    return [found for where in (folder, folder.parent) for found in sorted(where.glob("*.toml"))]


def _list_named_files(case_file: Path) -> Iterator[Path]:
    """Files that a TOML file names but for what it has written, and that are there."""
    try:
        if case_file.stat().st_size > LONGEST_CASE:
            return
        content = tomllib.loads(read_text(case_file, "case file", "check the path"))
    except (InputError, OSError, ValueError, RecursionError):
        return
    for text in _list_texts({key: value for key, value in content.items() if key != "output"}):
        if not text or "\0" in text or "\n" in text:
            continue
        named = str(case_file.parent / text)
        yield from map(Path, glob(named) if PATTERN.search(text) else [named])


def _list_texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list):
        for item in value.values() if isinstance(value, dict) else value:
            yield from _list_texts(item)
