"""Whether files are still those that were looked at before."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

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
        """Look at files.

        Parameters
        ----------
        paths : iterable of Path or None
            Those that are not there, or None, are left out.

        Returns
        -------
        FileStamps
            As they are now.
        """
        found = {path: _read_stamp(path) for path in paths if path is not None}
        return cls({path: stamp for path, stamp in found.items() if stamp is not None})

    def choose(self, paths: Iterable[Path | None]) -> FileStamps:
        """Leave out other files.

        Parameters
        ----------
        paths : iterable of Path or None
            What is kept, as far as it was looked at.

        Returns
        -------
        FileStamps
            Of these.
        """
        return FileStamps({path: self.stamps[path] for path in paths if path is not None and path in self.stamps})

    def list_changes(self) -> list[str]:
        """Say what has become of files that are no longer the same.

        Returns
        -------
        list of str
            A line each.
        """
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
