"""One run at a time writes a result."""

from __future__ import annotations

import fcntl
import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ddic.errors import InputError
from ddic.io.replace_on_exit import forget_unfinished, note_unfinished, remove_abandoned

LONGEST_NOTE = 200
"""Bytes of what a lock says of its holder."""


@contextmanager
def held_output(path: Path) -> Iterator[None]:
    """Hold a result's name while it is measured and written, and remove what killed runs have left in its folder.

    The lock is the system's, on a file ``.NAME.lock`` beside the result: it ends with the process that holds it. Where
    the file system knows no locks there is none.

    Parameters
    ----------
    path : Path
        The result file.

    Yields
    ------
    None
        While no other run has it.

    Raises
    ------
    InputError
        Where another run has it.
    OSError
        Where the disk takes no file.
    """
    lock = get_lock_path(path)
    try:
        descriptor = _take(path, lock)
    except OSError as error:
        error.filename = str(path)
        raise
    note_unfinished(lock)
    try:
        remove_abandoned(path.parent)
        yield
    finally:
        forget_unfinished(lock)
        with suppress(OSError):
            # Of a folder that can no longer be written to, nothing can be removed.
            lock.unlink(missing_ok=True)
        os.close(descriptor)


def get_lock_path(path: Path) -> Path:
    """Name the file whose lock a run holds while it measures and writes a result.

    Parameters
    ----------
    path : Path
        The result file.

    Returns
    -------
    Path
        Beside it.
    """
    return path.with_name(f".{path.name}.lock")


def _take(path: Path, lock: Path) -> int:
    """Take the lock; returns the descriptor that holds it."""
    while True:
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.pread(descriptor, LONGEST_NOTE, 0).decode("utf-8", "replace").strip() or "another process"
            os.close(descriptor)
            raise InputError(f"output.file: {path} is being written by another run ({holder}); wait for its end, or "
                             "choose another name") from None
        except OSError:
            # A file system without locks.
            return descriptor
        if os.fstat(descriptor).st_nlink:
            _sign(descriptor)
            return descriptor
        # Its last holder has removed it in between: another run may make it anew.
        os.close(descriptor)


def _sign(descriptor: int) -> None:
    """Say who holds the lock; a full disk is told of later, by what is written there."""
    try:
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, f"process {os.getpid()} on {platform.node()}\n".encode()[:LONGEST_NOTE], 0)
    except OSError:
        return
