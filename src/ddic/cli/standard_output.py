"""Standard output that may be full, closed, or unable to show a name."""

from __future__ import annotations

import errno
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from ddic.errors import DdicError

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EPIPE)
"""Errors of writing; those about a file name it."""


@contextmanager
def output_as_line() -> Iterator[None]:
    """End the program with a line on standard error where standard output cannot be written.

    Names of files that are no UTF-8 are printed with escapes.

    Raises
    ------
    OSError
        What the block raises for another reason.
    """
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="backslashreplace")
    try:
        yield
    except OSError as error:
        if not is_of_output(error):
            raise
        _end_at_output(error)
    except SystemExit:
        _require_written()
        raise
    _require_written()


def take_closed_pipes_as_errors() -> None:
    """Have a line that nobody reads any more be an error like others; call it where PETSc has begun.

    PETSc would end the process with ten lines.
    """
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)


def is_of_output(error: BaseException) -> bool:
    """Tell whether standard output could not be written.

    Parameters
    ----------
    error : BaseException
        Any.

    Returns
    -------
    bool
        False where the error names a file.
    """
    return isinstance(error, OSError) and error.filename is None and error.errno in FULL


def _require_written() -> None:
    try:
        sys.stdout.flush()
    except OSError as error:
        _end_at_output(error)


def _end_at_output(error: OSError) -> None:
    # Else Python tries once more on its way out, and says so in lines of its own.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if error.errno != errno.EPIPE:
        sys.stderr.write(f"standard output cannot be written ({error.strerror}); make room, or print elsewhere\n")
    sys.exit(DdicError.exit_code)
