"""Whether a case can run on the ranks that were started."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ddic.case.loader import LoadedCase, load_case_leniently
from ddic.errors import InputError
from ddic.io.file_stamps import FileStamps
from ddic.problem.check_images import check_decodable
from ddic.problem.check_inputs import check_inputs
from ddic.problem.check_output import list_named_files
from ddic.problem.check_report import CheckReport
from ddic.problem.gather_problems import Problems
from ddic.problem.rectangle import check_number_of_ranks
from ddic.solvers.factor_packages import require_packages


def check_ranks(loaded: LoadedCase, n_ranks: int) -> None:
    """Refuse more ranks than a case has subdomains, and solvers that PETSc has not on so many.

    Parameters
    ----------
    loaded : LoadedCase
        The case file.
    n_ranks : int
        MPI ranks that were started.

    Raises
    ------
    InputError
        Where a rank would have no subdomain, or no rows of the images, or PETSc lacks what the solver needs.
    """
    if loaded.case.pgd is not None:
        check_number_of_ranks(n_ranks)
        return
    solver = loaded.case.solver
    require_packages(str(loaded.path), solver.method, solver.local_inverse, n_ranks)
    if solver.method == "monolithic":
        if n_ranks > 1:
            raise InputError(f'{loaded.path}: solver.method = "monolithic" runs on one rank, {n_ranks} were started; '
                             'start one rank or use "dual"')
        return
    largest = solver.subdomains if solver.blocks is None else solver.blocks[0] * solver.blocks[1]
    if largest is not None and n_ranks > largest:
        key = "solver.subdomains" if solver.blocks is None else "solver.blocks"
        raise InputError(f"{loaded.path}: {key}: {largest} subdomains for {n_ranks} MPI ranks, but every rank needs at "
                         f"least one; start at most {largest} ranks or ask for more subdomains")


def load_checked_case(path: Path, n_ranks: int, output: Path | None = None) -> LoadedCase:
    """Load a case file and check everything that it names, free of communication.

    Parameters
    ----------
    path : Path
        The case file.
    n_ranks : int
        MPI ranks that were started.
    output : Path, optional
        The result file, in place of the one that the case names.

    Returns
    -------
    LoadedCase
        Ready to run.

    Raises
    ------
    InputError
        With all problems, one line each.
    """
    loaded, of_keys = _load_readable_keys(path)
    if output is not None:
        loaded = loaded.with_output(output)
    # Before they are checked: what changes afterwards was not.
    stamps = FileStamps.take(list_named_files(loaded.case))
    _check(loaded, of_keys, n_ranks)
    return replace(loaded, stamps=stamps)


def check_loaded_case(loaded: LoadedCase, n_ranks: int) -> None:
    """Check everything that a case names, and whether it can run, free of communication.

    Parameters
    ----------
    loaded : LoadedCase
        The case.
    n_ranks : int
        MPI ranks that were started.

    Raises
    ------
    InputError
        With all problems, one line each.
    """
    _check(loaded, (), n_ranks)


def check_case_file(path: Path) -> CheckReport:
    """Check a case file and everything that it names.

    Parameters
    ----------
    path : Path
        The case file.

    Returns
    -------
    CheckReport
        What the inputs are.

    Raises
    ------
    InputError
        With all problems, one line each.
    """
    loaded, of_keys = _load_readable_keys(path)
    report = _check(loaded, of_keys, None)
    problems = Problems()
    check_decodable(loaded.case.images, problems)
    for near in loaded.case.near:
        check_decodable(near, problems)
    problems.require_none()
    return report


def _load_readable_keys(path: Path) -> tuple[LoadedCase, list[str]]:
    """The case as far as it can be read, and what is wrong with its keys; raises InputError where that leaves none."""
    loaded, of_keys = load_case_leniently(path)
    if loaded is None:
        raise InputError(of_keys)
    return loaded, of_keys


def _check(loaded: LoadedCase, of_keys: Sequence[str], n_ranks: int | None) -> CheckReport:
    problems, report = Problems(), None
    problems.lines += of_keys
    with problems.gathered():
        report = check_inputs(loaded)
    with problems.gathered():
        # Who only checks is told of what would fail on any number of ranks.
        check_ranks(loaded, 1 if n_ranks is None else n_ranks)
    problems.require_none()
    if report is None:
        raise TypeError("inputs without problems have a report")
    return report
