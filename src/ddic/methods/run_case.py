"""A whole run of a case file, of a pair or of a series."""

from __future__ import annotations

from pathlib import Path

from ddic.check.case import load_checked_case
from ddic.errors import InputError, as_collective
from ddic.methods.run_pair import run_pair
from ddic.parallel.team import Team
from ddic.results.listener import Listener
from ddic.results.run_files import claimed_output
from ddic.results.series import SeriesSummary
from ddic.results.summary import Summary


def run_case(team: Team, path: Path, listener: Listener) -> Summary:
    """Run the case file of a pair; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    path : Path
        The case file.
    listener : Listener
        Told what happens.

    Returns
    -------
    Summary
        Also written beside the result.

    Raises
    ------
    DdicError
        On all ranks. Where the measurement does not converge, its last field is written under a name that says so, and
        an earlier result is moved out of the way; the message says where both are.
    """
    loaded = team.on_root(lambda: load_checked_case(path, team.size))
    if loaded.is_series:
        raise as_collective(InputError(f"{path}: images.deformed: names a series, one image is expected here"))
    with claimed_output(team, loaded.case.output.file):
        return run_pair(team, loaded, listener)


def run_file(team: Team, path: Path, listener: Listener, *, resume: bool = False) -> Summary | SeriesSummary:
    """Run a case file; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    path : Path
        The case file.
    listener : Listener
        Told what happens.
    resume : bool
        Whether to go on with a series where an earlier run stopped.

    Returns
    -------
    Summary or SeriesSummary
        Also written beside the result.

    Raises
    ------
    DdicError
        On all ranks, as ``run_pair`` and ``run_series`` do.
    """
    loaded = team.on_root(lambda: load_checked_case(path, team.size))
    if resume and not loaded.is_series:
        raise as_collective(InputError(f"--resume: {path} has one deformed image, no series to go on with; leave "
                                       "--resume out"))
    with claimed_output(team, loaded.case.output.file):
        if loaded.is_series:
            from ddic.methods.run_series import run_series

            return run_series(team, loaded, listener, resume=resume)
        return run_pair(team, loaded, listener)
