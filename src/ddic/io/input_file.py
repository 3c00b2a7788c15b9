"""Files to be read: whether they are there, what else belongs to them, and whether they are still those looked at.

The source tree that ddic runs from.
"""

from __future__ import annotations

import os
import re
import stat
import subprocess
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from ddic.errors import InputError


def as_path(name: object, what: str) -> Path:
    """Take the name of a file that Python code gives, a str or a Path; raises InputError for anything else."""
    if not isinstance(name, str | Path):
        raise InputError(f"{what}: {type(name).__name__} given, the name of a file expected")
    return Path(name)


def require_file(path: Path, what: str) -> None:
    """Refuse a path that leads to no file.

    ``what`` says what it should be, for the message. Raises InputError where nothing is there, where it is no regular
    file, or where the way there is closed; it says which.
    """
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError) as error:
        raise InputError(f"{path}: no such {what}; check the path") from error
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"{path}: this {what} cannot be read ({reason}); check path and permissions") from error
    if not stat.S_ISREG(mode):
        kind = "a folder" if stat.S_ISDIR(mode) else "no regular file"
        raise InputError(f"{path}: is {kind}, no such {what}; check the path")


def find_real_path(path: Path) -> Path:
    """Make a path absolute and free of links; where links go round in circles, as far as they can be followed.

    ``Path.resolve`` raises there, and who reads the file says it in its own words.
    """
    return Path(os.path.realpath(path))


def is_endless_file(path: Path) -> bool:
    """Tell whether a path leads to a pipe, socket or device, which may never end or begin; False where nothing is."""
    return os.path.exists(path) and not (os.path.isfile(path) or os.path.isdir(path))


def is_readable_file(path: Path) -> bool:
    """Tell whether a path leads to a regular file; False where the way is closed, goes in circles, or is too long."""
    return os.path.isfile(path)


DATASET = "::"
"""Between the name of a file and that of one of several arrays in it."""

SLICES = (".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff")
"""Endings of images that are slices of a volume where they share a folder."""

ZARR = ("zarr.json", ".zarray", ".zgroup")
"""One of them is in the folder of a Zarr array, or group of arrays."""

_DATA_FILE = re.compile(rb"^(?:ElementDataFile *=|data ?file:) *(.+?)\s*$", re.IGNORECASE | re.MULTILINE)
"""What MetaImage and NRRD call the file with the voxels that a header belongs to."""


def split_dataset(path: Path) -> tuple[Path, str]:
    """Split a path such as ``scan.h5::entry/data``: the file, and the array in it, empty where none is named."""
    file, mark, name = str(path).partition(DATASET)
    return (Path(file), name) if mark and not os.path.exists(path) else (path, "")


def is_zarr(folder: Path) -> bool:
    """Tell whether a folder is a Zarr array, or a group of them."""
    return any(is_readable_file(folder / name) for name in ZARR)


def split_numbers(path: Path) -> list[tuple[int, int, str]]:
    """Split a name into what sorts it as people number files: 2 before 10."""
    parts = re.split(r"(\d+)", str(path))
    return [(1, int(part), part) if part.isdecimal() else (0, 0, part) for part in parts]


def list_parts(path: Path) -> list[Path]:
    """List the files that make what a path names, which is one of them, or a folder of them, or of no other.

    They are the slices in a folder in the order of their numbers, all files of a Zarr folder, and the file that an
    array is in. A header comes with the file that holds the voxels, raw numbers with their sidecar.
    """
    file, name = split_dataset(path)
    try:
        if os.path.isdir(file):
            return _list_folder(file, name)
        beside = [find_sidecar(file)]
        if file.suffix.lower() in (".mhd", ".nhdr"):
            with file.open("rb") as stream:
                found = _DATA_FILE.search(stream.read(1 << 16))
            beside += [file.parent / os.fsdecode(found[1])] if found else []
        return [file, *filter(is_readable_file, beside)]
    except OSError:
        return [file]


def _list_folder(folder: Path, name: str) -> list[Path]:
    if is_zarr(folder):
        return sorted(file for file in (folder / name).rglob("*") if file.is_file())
    files = [Path(entry.path) for entry in os.scandir(folder) if entry.is_file() and not entry.name.startswith(".")]
    slices = [file for file in files if file.suffix.lower() in SLICES]
    return sorted(slices or files, key=split_numbers)


def find_sidecar(path: Path) -> Path:
    """Find the name of the file that says what raw numbers are."""
    return path.with_name(f"{path.name}.toml")


Stamp = tuple[int, int, int]
"""Number of the file in its file system, size in bytes, time of the last writing in nanoseconds."""


@dataclass(frozen=True)
class FileStamps:
    """What tells files from others that have later taken their names.

    Attributes
    ----------
    stamps : mapping of Path to Stamp
        By name.
    """

    stamps: Mapping[Path, Stamp] = field(default_factory=dict)

    @classmethod
    def take(cls, paths: Iterable[Path | None]) -> FileStamps:
        """Look at files, and all that belongs to them, as they are now; what is not there, or None, is left out."""
        found = {part: _read_stamp(part) for path in paths if path is not None for part in list_parts(path)}
        return cls({path: stamp for path, stamp in found.items() if stamp is not None})

    def choose(self, paths: Iterable[Path | None]) -> FileStamps:
        """Keep the stamps of the given files, as far as they were looked at, and leave out others."""
        parts = (part for path in paths if path is not None for part in list_parts(path))
        return FileStamps({part: self.stamps[part] for part in parts if part in self.stamps})

    def list_changes(self) -> list[str]:
        """Say what has become of files that are no longer the same, a line each."""
        lines = []
        for path, before in self.stamps.items():
            now = _read_stamp(path)
            if now != before:
                what = "is no longer there" if now is None else "was written to or replaced"
                lines.append(f"{path}: {what} while it was in use; keep what a case names as it is during a run")
        return lines


def _read_stamp(path: Path) -> Stamp | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_ino, status.st_size, status.st_mtime_ns


def find_source_commit() -> str:
    """Find the commit of the source tree that ddic runs from, hexadecimal; "unknown" for an installed package."""
    root = Path(__file__).resolve().parents[3]
    if not (root / ".git").exists():
        return "unknown"
    try:
        done = subprocess.run(["git", "-C", str(root), "rev-parse", "HEAD"], capture_output=True, text=True,
                              timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return done.stdout.strip()
