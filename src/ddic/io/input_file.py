"""Files to be read: whether they are there, and still those looked at before; the source tree that ddic runs from."""

from __future__ import annotations

import os
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
        """Look at files as they are now; those that are not there, or None, are left out."""
        found = {path: _read_stamp(path) for path in paths if path is not None}
        return cls({path: stamp for path, stamp in found.items() if stamp is not None})

    def choose(self, paths: Iterable[Path | None]) -> FileStamps:
        """Keep the stamps of the given files, as far as they were looked at, and leave out others."""
        return FileStamps({path: self.stamps[path] for path in paths if path is not None and path in self.stamps})

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
