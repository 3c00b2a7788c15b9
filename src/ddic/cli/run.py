"""``ddic run``: measure a case."""

from __future__ import annotations

import signal
import sys
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import NoReturn, TextIO

import click


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("case_file", metavar="CASE.toml", type=click.Path(path_type=Path))
@click.argument("petsc_options", nargs=-1, type=click.UNPROCESSED)
def run(case_file: Path, petsc_options: tuple[str, ...]) -> None:
    """Measure the displacement between the two images of a case; alone or under mpirun.

    Options that PETSC_OPTIONS give pass to PETSc, for instance -dual_ksp_monitor.
    """
    unknown = [option for option in petsc_options if option.startswith("--")]
    if unknown:
        raise click.UsageError(f"no such option: {unknown[0]}; PETSc's options begin with one dash")
    signal.signal(signal.SIGTERM, _stop)
    # Imported here because MPI and PETSc start with them, which --help does not need.
    import petsc4py

    petsc4py.init(["ddic", *petsc_options])
    sys.exit(_run_everywhere(case_file))


def _run_everywhere(case_file: Path) -> int:
    """Run on all ranks; an error that only this rank has ends the job."""
    import cv2

    from ddic.cli.console import RunConsole
    from ddic.methods.run_case import run_case
    from ddic.parallel.team import Team
    from ddic.results.listener import Silence

    cv2.setNumThreads(1)
    team = Team.world()
    try:
        with _warnings_told_once(team.is_root):
            if not team.is_root:
                run_case(team, case_file, Silence())
                return 0
            with RunConsole() as console:
                console.finish(run_case(team, case_file, console))
    except BaseException as error:
        return _failed(team, error)
    return 0


@contextmanager
def _warnings_told_once(speaks: bool) -> Iterator[None]:
    """Show warnings about the inputs as one line each, where ``speaks``; all ranks open the same images."""
    told: set[str] = set()

    def show(message: Warning | str, category: type[Warning], filename: str, lineno: int,
             file: TextIO | None = None, line: str | None = None) -> None:
        text = str(message)
        if not issubclass(category, UserWarning):
            click.echo(warnings.formatwarning(message, category, filename, lineno, line), err=True, nl=False)
        elif speaks and text not in told:
            told.add(text)
            click.echo(f"warning: {text}", err=True)

    with warnings.catch_warnings():
        warnings.showwarning = show
        yield


def _failed(team: object, error: BaseException) -> int:
    """Say what went wrong, once, and return the exit code or end the job."""
    from ddic.errors import DdicError, is_collective
    from ddic.parallel.team import Team

    assert isinstance(team, Team)
    everywhere = is_collective(error)
    code = error.exit_code if isinstance(error, DdicError) else 1
    if team.is_root or not everywhere:
        where = "" if team.size == 1 or everywhere else f"rank {team.rank}: "
        if isinstance(error, DdicError):
            lines = [f"{where}{line}" for line in str(error).splitlines()]
        elif isinstance(error, OSError):
            lines = [f"{where}{error.filename or 'a file'} could not be read or written: {error.strerror or error}"]
        elif isinstance(error, KeyboardInterrupt | SystemExit):
            lines, code = [f"{where}interrupted; no result was written"], 130
        else:
            lines = [f"{where}{line}" for line in _trace(error).splitlines()]
        sys.stdout.flush()
        click.echo("\n".join(lines), err=True)
        sys.stderr.flush()
    if team.size > 1 and not everywhere:
        team.abort(code)
    return code


def _trace(error: BaseException) -> str:
    """Where an unexpected error happened: on its own rank, if that rank left a note, else here."""
    notes: list[str] = getattr(error, "__notes__", [])
    return "\n".join(notes) or "".join(traceback.format_exception(error))


def _stop(number: int, frame: FrameType | None) -> NoReturn:
    # mpirun turns Ctrl-C into SIGTERM; raising lets temporary files be removed.
    """Raise an error at mpirun's SIGTERM."""
    raise KeyboardInterrupt
