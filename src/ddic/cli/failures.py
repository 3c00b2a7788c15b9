"""How a job under MPI that fails says why, once, and ends on all ranks.

Errors, what PETSc raises and warnings become lines of the command line.
"""

from __future__ import annotations

import os
import re
import sys
import traceback
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ddic.cli.failed_start import FULL
from ddic.errors import DdicError, InputError, WriteError, is_collective, is_disk_failure
from ddic.io.replace_on_exit import remove_unfinished
from ddic.parallel.stop_request import INTERRUPTED, is_launcher

if TYPE_CHECKING:
    from ddic.parallel.team import Team


@contextmanager
def errors_as_lines(target: Path | None = None) -> Iterator[None]:
    """End the program where the block fails, with a line for each problem on standard error.

    ``target`` is the file or folder that the block writes to. Where there is none, an OSError that names no file is
    raised.
    """
    try:
        yield
    except DdicError as error:
        click.echo(str(error), err=True)
        sys.exit(error.exit_code)
    except OSError as error:
        if target is not None and _is_within(error.filename, target):
            click.echo(f"{target}: cannot be written to ({error.strerror}); choose another --output", err=True)
        elif error.filename is not None:
            click.echo(f"{os.fsdecode(error.filename)}: cannot be read or written ({error.strerror}); check the path, "
                       "its permissions and the space left", err=True)
        else:
            raise
        sys.exit(WriteError.exit_code if is_disk_failure(error) else InputError.exit_code)


def _is_within(name: str | bytes | int | None, target: Path) -> bool:
    """Whether what failed is the target, or a file in it or beside it; also where nothing tells what failed."""
    if not isinstance(name, str | bytes):
        return True
    path, place = os.path.abspath(os.fsdecode(name)), os.path.abspath(target)
    return path.startswith(place) or os.path.dirname(path) == os.path.dirname(place)


OF_OPTIONS = (56, 60, 62, 63, 65, 67, 83, 86, 92)
"""PETSc's numbers of errors that a wrong option makes: not supported, wrong size, type, range or value, no such file or
kind, no such package."""


def is_petsc_error(error: BaseException) -> bool:
    """Tell whether an error is PETSc's; False too where PETSc has not been imported."""
    petsc = sys.modules.get("petsc4py.PETSc")
    return petsc is not None and isinstance(error, petsc.Error)


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


def show_failure(team: Team, error: BaseException, petsc_options: Sequence[str] = ()) -> int:
    """Say what went wrong, once, and return the exit code, where all ranks failed.

    What this rank alone knows ends the job. ``error`` ended the work here; ``petsc_options`` are the words that PETSc
    was given.
    """
    everywhere = is_collective(error)
    lines, code = _describe(error, petsc_options)
    if team.is_root or not everywhere:
        where = "" if team.size == 1 or everywhere else f"rank {team.rank}: "
        with suppress(OSError):
            # It may be what failed.
            sys.stdout.flush()
        click.echo("\n".join(f"{where}{line}" for line in lines), err=True)
        sys.stderr.flush()
    if team.size > 1 and not everywhere:
        remove_unfinished()
        team.abort(code)
    return code


def abort_quietly(team: Team, code: int) -> None:
    """End all ranks where a launcher waits for them, which else has ten lines of its own to say; collective.

    All ranks have failed; ``code`` is the exit code.
    """
    if team.size > 1 and is_launcher(os.getppid()):
        team.wait_for_all()
        team.abort(code)


def _describe(error: BaseException, petsc_options: Sequence[str]) -> tuple[list[str], int]:
    """What is said of an error, and the exit code."""
    if isinstance(error, DdicError):
        return str(error).splitlines(), error.exit_code
    if isinstance(error, OSError):
        line = f"{_name_file(error)} could not be read or written: {error.strerror or error}"
        if is_disk_failure(error):
            line += "; nothing was left of it, and what was there before still is"
        return [line], 1
    if is_petsc_error(error):
        said, code = describe_petsc_error(error, petsc_options)
        return [said], code
    if isinstance(error, KeyboardInterrupt | SystemExit):
        return ["interrupted; no result was written"], INTERRUPTED
    return _trace(error).splitlines(), 1


def _name_file(error: OSError) -> str:
    """The file that an error is about; HDF5 names it in its text alone."""
    if error.filename is not None:
        return str(os.fsdecode(error.filename))
    named = re.search(r"name = '([^']+)'", str(error))
    if named:
        return named[1]
    return "standard output, or a file," if error.errno in FULL else "a file"


def _trace(error: BaseException) -> str:
    """Where an unexpected error happened: on its own rank, if that rank left a note, else here."""
    notes: list[str] = getattr(error, "__notes__", [])
    return "\n".join(notes) or "".join(traceback.format_exception(error))


@contextmanager
def warnings_as_lines() -> Iterator[None]:
    """Print what is warned of inside, a line each on standard error, after the block unless it fails."""
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always", UserWarning)
        yield
    for warning in warned:
        # Others are libraries' own, on what they do and not on what was given to them.
        if not issubclass(warning.category, UserWarning):
            continue
        click.echo(f"warning: {warning.message}", err=True)
