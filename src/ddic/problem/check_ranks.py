"""Whether a case can run on the ranks that were started."""

from __future__ import annotations

from pathlib import Path

from ddic.case.loader import LoadedCase, load_case_leniently
from ddic.errors import InputError
from ddic.problem.check_inputs import check_inputs
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


def load_checked_case(path: Path, n_ranks: int) -> LoadedCase:
    """Load a case file and check everything that it names, free of communication.

    Parameters
    ----------
    path : Path
        The case file.
    n_ranks : int
        MPI ranks that were started.

    Returns
    -------
    LoadedCase
        Ready to run.

    Raises
    ------
    InputError
        With all problems, one line each.
    """
    loaded, _ = _load_and_check(path, n_ranks)
    return loaded


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
    return _load_and_check(path, None)[1]


def _load_and_check(path: Path, n_ranks: int | None) -> tuple[LoadedCase, CheckReport]:
    loaded, of_keys = load_case_leniently(path)
    if loaded is None:
        raise InputError(of_keys)
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
    return loaded, report
