"""How ddic fails: in lines, once, with an exit code, and with all ranks of its job.

From the outside in: standard output that cannot be written; whatever a command lets pass, before the ranks of a job
know of one another; what all of them raise together, or one of them alone; warnings. Nothing here needs a package that
may be missing.
"""

from __future__ import annotations

import errno
import os
import re
import signal
import sys
import traceback
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from ddic.errors import DdicError, InputError, WriteError, is_collective, is_disk_failure
from ddic.io.replace_on_exit import remove_unfinished
from ddic.parallel.stop_request import INTERRUPTED, abort_all_ranks, find_rank, is_launcher

if TYPE_CHECKING:
    from ddic.parallel.team import Team

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
        if not _is_of_output(error):
            raise
        _end_at_output(error)
    except SystemExit:
        _require_written()
        raise
    _require_written()


def _require_written() -> None:
    try:
        sys.stdout.flush()
    except OSError as error:
        _end_at_output(error)


def take_closed_pipes_as_errors() -> None:
    """Have a closed pipe be an error like others, for which PETSc, if begun, would end the process with ten lines."""
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)


def _is_of_output(error: BaseException) -> bool:
    """Whether an error says that standard output could not be written; an error about a file names it."""
    return isinstance(error, OSError) and error.filename is None and error.errno in FULL


def _end_at_output(error: OSError) -> NoReturn:
    # Else Python tries once more on its way out, and says so in lines of its own.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if error.errno != errno.EPIPE:
        _say(f"standard output cannot be written ({error.strerror}); make room, or print elsewhere")
    sys.exit(DdicError.exit_code)


@contextmanager
def failures_as_lines(target: Path | None = None, passed: tuple[type[BaseException], ...] = ()) -> Iterator[None]:
    """End the program where the block fails, with all ranks of its job: their end would wait for one another.

    ``target`` is the file or folder that the block writes to. Errors in ``passed``, and ``SystemExit``, are left to
    somebody else. What is unexpected is raised where this is no rank of a job; so is what standard output does not
    take.
    """
    try:
        yield
    except passed:
        raise
    except (Exception, KeyboardInterrupt) as error:
        told = _describe_alone(error, target)
        if told is None:
            raise
        line, code = told
        if find_rank() is not None:
            abort_all_ranks(line, code)
        _say(line)
        sys.exit(code)


def _describe_alone(error: BaseException, target: Path | None) -> tuple[str, int] | None:
    """What a rank says that ends without asking the others, and the exit code; None where its trace says more."""
    if isinstance(error, KeyboardInterrupt):
        return "interrupted", INTERRUPTED
    if isinstance(error, DdicError):
        return str(error), error.exit_code
    if isinstance(error, OSError) and (target is not None or error.filename is not None):
        code = WriteError.exit_code if is_disk_failure(error) else InputError.exit_code
        return _describe_file(error, target), code
    said = _describe_unexpected(error)
    rank = find_rank()
    where = f"rank {rank}: " if rank else ""
    return None if said is None else (f"{where}{said}", 1)


_NO_CACHE = "no locator available for file"
"""What numba says where it finds no folder for compiled kernels that it may write to."""


def _describe_unexpected(error: BaseException) -> str | None:
    """What keeps a program from starting, in a line, or where a rank of a job failed."""
    said = " ".join(str(error).split())
    if isinstance(error, MemoryError):
        return f"out of memory{f' ({said})' if said else ''}: see free -m, and ulimit -v"
    if isinstance(error, ImportError):
        return f"ddic could not start ({type(error).__name__}: {said})"
    if _NO_CACHE in said:
        return ("there is no folder in which compiled kernels can be kept; set NUMBA_CACHE_DIR to one that you may "
                "write to")
    if find_rank() is None or _is_of_output(error):
        return None
    return "".join(traceback.format_exception(error))


def _describe_file(error: OSError, target: Path | None) -> str:
    """Which file could not be read or written; the target too where nothing tells what failed."""
    name = error.filename
    if target is not None and (not isinstance(name, str | bytes) or _is_within(os.fsdecode(name), target)):
        return f"{target}: cannot be written to ({error.strerror}); choose another --output"
    return (f"{os.fsdecode(name)}: cannot be read or written ({error.strerror}); check the path, its permissions and "
            "the space left")


def _is_within(name: str, target: Path) -> bool:
    """Whether a file is the target, or lies in it or beside it."""
    path, place = os.path.abspath(name), os.path.abspath(target)
    return path.startswith(place) or os.path.dirname(path) == os.path.dirname(place)


def show_failure(team: Team, error: BaseException, petsc_options: Sequence[str] = ()) -> int:
    """Say what went wrong, once, and return the exit code, where all ranks failed.

    What this rank alone knows ends the job. ``error`` ended the work here; ``petsc_options`` are the words that PETSc
    was given.
    """
    everywhere = is_collective(error)
    said, code = _describe_in_team(error, petsc_options)
    if team.is_root or not everywhere:
        where = "" if team.size == 1 or everywhere else f"rank {team.rank}: "
        with suppress(OSError):
            # It may be what failed.
            sys.stdout.flush()
        _say("\n".join(f"{where}{line}" for line in said.splitlines()))
        sys.stderr.flush()
    if team.size > 1 and not everywhere:
        remove_unfinished()
        team.abort(code)
    return code


def abort_quietly(team: Team, code: int) -> None:
    """End all ranks, which have failed, where a launcher waits for them, which else says ten lines; collective."""
    if team.size > 1 and is_launcher(os.getppid()):
        team.wait_for_all()
        team.abort(code)


def _describe_in_team(error: BaseException, petsc_options: Sequence[str]) -> tuple[str, int]:
    """What is said of an error where ranks know of one another, and the exit code."""
    if isinstance(error, DdicError):
        return str(error), error.exit_code
    if isinstance(error, OSError):
        line = f"{_name_file(error)} could not be read or written: {error.strerror or error}"
        if is_disk_failure(error):
            line += "; nothing was left of it, and what was there before still is"
        return line, 1
    if isinstance(error, KeyboardInterrupt | SystemExit):
        return "interrupted; no result was written", INTERRUPTED
    petsc = sys.modules.get("petsc4py.PETSc")
    if petsc is not None and isinstance(error, petsc.Error):
        return describe_petsc_error(error, petsc_options)
    # Where it happened: on another rank, if that left a note, else here.
    notes: list[str] = getattr(error, "__notes__", [])
    return "\n".join(notes) or "".join(traceback.format_exception(error)), 1


def _name_file(error: OSError) -> str:
    """The file that an error is about; HDF5 names it in its text alone."""
    if error.filename is not None:
        return str(os.fsdecode(error.filename))
    named = re.search(r"name = '([^']+)'", str(error))
    if named:
        return named[1]
    return "standard output, or a file," if error.errno in FULL else "a file"


OF_OPTIONS = (56, 60, 62, 63, 65, 67, 83, 86, 92)
"""PETSc's numbers of errors that a wrong option makes: not supported, wrong size, type, range or value, no such file or
kind, no such package."""


def describe_petsc_error(error: BaseException, options: Sequence[str]) -> tuple[str, int]:
    """Say what PETSc refused and why, in a line, and whose fault it may be, as an exit code.

    The code is that of a wrong input where ``options`` of PETSc were given on the command line and the error is one
    that they make.
    """
    number = getattr(error, "ierr", None)
    said = [re.sub(r"^\[\d+\] ", "", line).strip() for line in str(error).splitlines()]
    reason = next((line for line in reversed(said) if line and " at " not in line), "no reason given")
    if options and number in OF_OPTIONS:
        return f"PETSc refuses its options {' '.join(options)}: {reason} (error {number})", InputError.exit_code
    return f"PETSc failed: {reason} (error {number})", DdicError.exit_code


@contextmanager
def warnings_as_lines() -> Iterator[None]:
    """Print what is warned of inside, a line each on standard error, after the block unless it fails."""
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always", UserWarning)
        yield
    for warning in warned:
        # Others are libraries' own, on what they do and not on what was given to them.
        if issubclass(warning.category, UserWarning):
            _say(f"warning: {warning.message}")


def _say(line: str) -> None:
    sys.stderr.write(f"{line}\n")
