"""``ddic run``: measure a case."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn, TextIO

import click

from ddic.cli.entry import imports_kept, prepare_workspaces
from ddic.cli.failures import abort_quietly, show_failure, take_closed_pipes_as_errors
from ddic.errors import ConvergenceError, InputError
from ddic.io.input_file import is_readable_file
from ddic.io.replace_on_exit import remove_unfinished
from ddic.parallel.stop_request import INTERRUPTED, StopRequest, find_rank, prepare_abort

if TYPE_CHECKING:
    from ddic.parallel.team import Team
    from ddic.results.listener import Listener
    from ddic.results.summary import SeriesSummary, Summary

ALONE = {"OMPI_MCA_pml": "ob1", "OMPI_MCA_btl": "self"}
"""Settings of Open MPI for a process without a launcher: it has nobody to talk to, and looking for fast networks takes
a fifth of a second. Ranks of a job that had them could not reach one another."""

ON_ONE_NODE = {"OMPI_MCA_pml": "ob1"}
"""Settings of Open MPI for ranks that a launcher has started on one node: they meet in its memory."""

COUNTS = ("OMPI_COMM_WORLD_SIZE", "OMPI_COMM_WORLD_LOCAL_SIZE")
"""Where Open MPI's launcher says how many ranks there are, and how many of them on this node."""

FILE_OPTIONS = ("-options_file", "-options_file_yaml")
"""PETSc's options that name a file of further ones, which it looks for when it starts."""


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("case_file", metavar="CASE.toml", type=click.Path(path_type=Path))
@click.option("--resume", is_flag=True, help="Go on with a series where an earlier run of it stopped.")
@click.argument("petsc_options", nargs=-1, type=click.UNPROCESSED)
@click.pass_obj
def run(stop: StopRequest | None, case_file: Path, petsc_options: tuple[str, ...], *, resume: bool) -> None:
    """Measure the displacement between the images of a case, a pair or a series; alone or under mpirun.

    Options that PETSC_OPTIONS give pass to PETSc, for instance -dual_ksp_monitor.
    """
    _check_words(case_file, petsc_options)

    def work(team: Team, listener: Listener) -> Summary | SeriesSummary:
        from ddic.methods.run import run_file

        return run_file(team, case_file, listener, resume=resume)

    measure_everywhere(stop, work, petsc_options)


def measure_everywhere(stop: StopRequest | None, work: Callable[[Team, Listener], Summary | SeriesSummary],
                       petsc_options: tuple[str, ...] = ()) -> NoReturn:
    """Start MPI and PETSc, let all ranks measure, rank 0 telling how it goes, and end the program."""
    if stop is None:  # by another way than the program's own beginning
        stop = StopRequest()
        stop.note_signals()
    stop.before_end = remove_unfinished
    # Alone, Open MPI would start a daemon that needs files of megabytes, which a limit of file sizes forbids.
    os.environ.setdefault("OMPI_MCA_ess_singleton_isolated", "1")
    with imports_kept():
        team = _start(petsc_options, stop)
    code = _work_on_all(team, work, petsc_options)
    stop.is_over = True
    sys.exit(code)


def _check_words(case_file: Path, words: tuple[str, ...]) -> None:
    """Refuse what is neither the one case file, nor an option of PETSc, nor the value of one."""
    if str(case_file).startswith("-"):
        raise InputError(f"{case_file} stands where the case file belongs: ddic run CASE.toml [PETSc options]")
    takes_value = False
    for option, value in pairwise((*words, "")):
        if option in FILE_OPTIONS and not is_readable_file(Path(value)):
            raise InputError(f"{option} {value}: no such file of PETSc's options; check the path")
    for word in words:
        if word.startswith("--"):
            raise InputError(f"no such option: {word}; PETSc's options begin with one dash")
        is_option = word.startswith("-") and not _is_number(word)
        if not is_option and (not takes_value or word.endswith(".toml")):
            raise InputError(f"{word} is one word too many: ddic run takes one case file, then PETSc's options; "
                             "run several cases one after the other")
        takes_value = is_option


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _start(petsc_options: tuple[str, ...], stop: StopRequest) -> Team:
    """Import all that a run needs, and start MPI and PETSc with it; a failure from here on ends all ranks."""
    prepare_abort()
    # Imported here because MPI and PETSc start with them, which --help does not need.
    import cv2
    import petsc4py

    with _no_needless_networks():
        petsc4py.init(["ddic", *petsc_options])
    take_closed_pipes_as_errors()
    import ddic.methods.run
    import ddic.results.listener
    import ddic.solvers.petsc
    from ddic.mesh.raster import prepare_kernels
    from ddic.parallel.team import Team

    cv2.setNumThreads(1)
    prepare_workspaces()
    # Here all ranks do so at once; later rank 0 alone, which checks the case, and then the others.
    prepare_kernels()
    team = replace(Team.world(), stop=stop)
    if team.is_root:
        import ddic.results.console  # noqa: F401
    stop.has_begun = True
    return team


@contextmanager
def _no_needless_networks() -> Iterator[None]:
    """Start MPI in the block without looking for networks where all ranks are on this node, or there is no launcher.

    What the environment says already is kept, and no program that is started later finds more in it.
    """
    n_ranks, n_here = map(os.environ.get, COUNTS)
    on_one_node = ON_ONE_NODE if n_ranks is not None and n_ranks == n_here else {}
    settings = ALONE if find_rank() is None else on_one_node
    added = {name: value for name, value in settings.items() if name not in os.environ}
    os.environ.update(added)
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]


def _work_on_all(team: Team, work: Callable[[Team, Listener], Summary | SeriesSummary],
                 petsc_options: tuple[str, ...]) -> int:
    """Work on all ranks, and return the exit code; an error that only this rank has ends the job."""
    from ddic.results.listener import Silence

    try:
        with _warnings_told_once(team.is_root):
            if not team.is_root:
                work(team, Silence())
            else:
                from ddic.results.console import RunConsole

                with RunConsole() as console:
                    console.finish(work(team, console))
        _warn_of_unused_options(team, petsc_options)
    except BaseException as error:
        return _failed(team, error, petsc_options)
    return 0


def _warn_of_unused_options(team: Team, petsc_options: tuple[str, ...]) -> None:
    """Tell once which options of PETSc changed nothing; collective."""
    from ddic.solvers.petsc import list_unused_options

    for option in list_unused_options(team, petsc_options):
        if team.is_root:
            click.echo(f"warning: PETSc's option {option} was never asked for: it is mistyped, or belongs to what this "
                       "run did not do", err=True)


@contextmanager
def _warnings_told_once(speaks: bool) -> Iterator[None]:
    """Show warnings about the inputs as one line each, where ``speaks``; all ranks open the same images."""
    told: set[str] = set()

    def show(message: Warning | str, category: type[Warning], filename: str, lineno: int,
             file: TextIO | None = None, line: str | None = None) -> None:
        text = str(message)
        # Others are libraries' own, on what they do and not on what was given to them.
        if issubclass(category, UserWarning) and speaks and text not in told:
            told.add(text)
            click.echo(f"warning: {text}", err=True)

    with warnings.catch_warnings():
        warnings.showwarning = show
        yield


def _failed(team: Team, error: BaseException, petsc_options: tuple[str, ...]) -> int:
    """Say what went wrong, once, and return the exit code or end the job."""
    team.stop.is_over = True
    if team.stop.is_by_launcher:
        # Which ends all ranks: another one has failed and says why, or the user has ended the launcher.
        os._exit(INTERRUPTED)
    code = show_failure(team, error, petsc_options)
    if isinstance(error, ConvergenceError):
        # It may be why.
        _warn_of_unused_options(team, petsc_options)
    abort_quietly(team, code)
    return code
