"""How a job under MPI that fails says why, once, and ends on all ranks."""

from __future__ import annotations

import os
import re
import sys
import traceback
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

import click

from ddic.cli.petsc_error import describe_petsc_error, is_petsc_error
from ddic.cli.standard_output import FULL
from ddic.errors import DdicError, is_collective, is_disk_failure
from ddic.io.replace_on_exit import remove_unfinished
from ddic.parallel.abort_all_ranks import INTERRUPTED, is_launcher

if TYPE_CHECKING:
    from ddic.parallel.team import Team


def show_failure(team: Team, error: BaseException, petsc_options: Sequence[str] = ()) -> int:
    """Say what went wrong, once; what this rank alone knows ends the job.

    Parameters
    ----------
    team : Team
        All ranks.
    error : BaseException
        What ended the work here.
    petsc_options : sequence of str, optional
        Words that PETSc was given.

    Returns
    -------
    int
        The exit code, where all ranks failed.
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

    Parameters
    ----------
    team : Team
        All ranks, which have failed.
    code : int
        The exit code.
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
