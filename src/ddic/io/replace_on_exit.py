"""Files that appear under their name only when they are complete."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ddic.errors import InputError


def make_temporary_name(path: Path) -> Path:
    """Name a file under construction.

    Parameters
    ----------
    path : Path
        Final name.

    Returns
    -------
    Path
        In the same folder, another for every process.
    """
    return path.with_name(f".{path.name}.{os.getpid()}.tmp")


@contextmanager
def replaced_on_exit(path: Path) -> Iterator[Path]:
    """Yield a temporary name that is renamed to ``path`` on a clean exit and removed on any other.

    Parameters
    ----------
    path : Path
        Final name.

    Yields
    ------
    Path
        Temporary name.

    Raises
    ------
    InputError
        If the folder does not exist or cannot be written to.
    """
    if not path.parent.is_dir() or not os.access(path.parent, os.W_OK):
        raise InputError(f"{path}: the folder {path.parent} does not exist or cannot be written to; "
                         "make it, or choose another output file")
    temporary = make_temporary_name(path)
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
