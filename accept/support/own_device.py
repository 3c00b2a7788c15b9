"""Devices of a check's own, lest a fault replace one of the system's."""

from __future__ import annotations

import os
import stat
from pathlib import Path

NULL, FULL = 3, 7
"""Numbers of devices of memory: the one that takes all, and the one that is full."""


def make_device(path: Path, number: int = NULL) -> None:
    """Make a device; a pipe where this user may have none.

    Parameters
    ----------
    path : Path
        Where.
    number : int, optional
        NULL or FULL.
    """
    try:
        os.mknod(path, 0o666 | stat.S_IFCHR, os.makedev(1, number))
    except OSError:
        os.mkfifo(path)
