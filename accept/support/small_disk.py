"""A small disk in memory, to be filled."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bench.support.runs import NotHereError


@contextmanager
def small_disk(folder: Path, kib: int) -> Iterator[None]:
    """Mount a disk for as long as the block runs.

    Parameters
    ----------
    folder : Path
        Where; made here.
    kib : int
        Its size.

    Raises
    ------
    NotHereError
        Where this user may not have one.
    """
    folder.mkdir()
    try:
        done = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={kib}k", "tmpfs", str(folder)], text=True,
                              capture_output=True, check=False)
    except OSError as error:
        raise NotHereError(f"there is no mount here ({error})") from error
    if done.returncode:
        raise NotHereError(f"no disk can be mounted ({done.stderr.strip()})")
    try:
        yield
    finally:
        subprocess.run(["umount", str(folder)], check=True)
