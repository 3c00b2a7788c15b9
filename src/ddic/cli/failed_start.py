"""What no command takes care of, a start that fails above all: one line where that says enough, and no rank waits.

Standard output that may be full, closed, or unable to show a name.
"""

from __future__ import annotations

import errno
import os
import signal
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NoReturn

from ddic.errors import DdicError
from ddic.parallel.stop_request import INTERRUPTED, abort_all_ranks, find_rank

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EPIPE)
"""Errors of writing; those about a file name it."""


@contextmanager
def output_as_line() -> Iterator[None]:
    """End the program with a line on standard error where standard output cannot be written.

    Names of files that are no UTF-8 are printed with escapes. An OSError that the block raises for another reason
    passes.
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
    """Tell whether an error says that standard output could not be written; False where the error names a file."""
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


_NO_CACHE = "no locator available for file"
"""What numba says where it finds no folder for compiled kernels that it may write to."""


@contextmanager
def failures_as_lines(passed: tuple[type[BaseException], ...] = ()) -> Iterator[None]:
    """End the program where the block fails, with all ranks of its job: their end would wait for one another.

    Errors in ``passed``, and ``SystemExit``, are left to somebody else. What is unexpected is raised where this is no
    rank of a job; so is what standard output does not take.
    """
    try:
        yield
    except SystemExit:
        raise
    except passed:
        raise
    except KeyboardInterrupt:
        _end("interrupted", INTERRUPTED)
    except DdicError as error:
        _end(str(error), error.exit_code)
    except (ImportError, MemoryError) as error:
        _end(f"{_name_rank()}{describe_briefly(error)}", 1)
    except Exception as error:
        if _NO_CACHE in str(error):
            _end(f"{_name_rank()}there is no folder in which compiled kernels can be kept; set NUMBA_CACHE_DIR to one "
                 "that you may write to", 1)
        if find_rank() is None or is_of_output(error):
            raise
        _end(f"{_name_rank()}{''.join(traceback.format_exception(error))}", 1)


def describe_briefly(error: BaseException) -> str:
    """Describe in one line what unexpectedly keeps a program from starting: what it says and its kind.

    A lack of memory is told in words.
    """
    said = " ".join(str(error).split())
    if isinstance(error, MemoryError):
        return f"out of memory{f' ({said})' if said else ''}: see free -m, and ulimit -v"
    return f"ddic could not start ({type(error).__name__}: {said})"


def _name_rank() -> str:
    rank = find_rank()
    return f"rank {rank}: " if rank else ""


def _end(line: str, code: int) -> NoReturn:
    if find_rank() is not None:
        abort_all_ranks(line, code)
    sys.stderr.write(f"{line}\n")
    sys.exit(code)
