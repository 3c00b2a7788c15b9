"""What C libraries write straight to standard error, past Python, caught."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock
from typing import IO

STANDARD_ERROR = 2

_LOCK = Lock()


@contextmanager
def caught_messages() -> Iterator[list[str]]:
    """Catch the lines that are written to standard error inside.

    Yields
    ------
    list of str
        Empty; filled with the lines, without blank ones, on the way out.
    """
    lines: list[str] = []
    with _LOCK, _open_scratch() as caught:
        sys.stderr.flush()
        try:
            kept = os.dup(STANDARD_ERROR)
        except OSError:
            # Closed: nothing is to be seen of it anyway.
            yield lines
            return
        os.dup2(caught.fileno(), STANDARD_ERROR)
        try:
            yield lines
        finally:
            sys.stderr.flush()
            os.dup2(kept, STANDARD_ERROR)
            os.close(kept)
            caught.seek(0)
            lines += [line for line in caught.read().decode(errors="replace").splitlines() if line.strip()]


def _open_scratch() -> IO[bytes]:
    """A file of no folder: what is decoded may be all that a full disk has room for."""
    if hasattr(os, "memfd_create"):
        return os.fdopen(os.memfd_create("messages"), "w+b")
    return tempfile.TemporaryFile()
