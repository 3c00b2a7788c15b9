"""A whole run of a case file, of a pair or of a series.

Of a pair: inputs opened, field measured, result and summary written.
"""

from pathlib import Path

from ddic.case.loader import LoadedCase
from ddic.check.case import load_checked_case
from ddic.errors import DdicError, InputError, as_collective
from ddic.inputs.inputs import inputs_kept, open_inputs
from ddic.methods.method import prepare_session
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team
from ddic.results.listener import Listener
from ddic.results.publishing import Destination
from ddic.results.run_files import claimed_output, keep_failed_run, remove_failed_field, write_run
from ddic.results.series import SeriesSummary
from ddic.results.summary import Summary


def run_pair(team: Team, loaded: LoadedCase, listener: Listener) -> Summary:
    """Run a case that was loaded, with one deformed image of each camera; collective.

    Returns the summary, also written beside the result. Raises DdicError on all ranks. Where the measurement does not
    converge, its last field is written under a name that says so, and an earlier result is moved out of the way; the
    message says where both are.
    """
    output, start = loaded.case.output, loaded.case.start.from_result
    clock = PhaseClock(entered=listener.phase, advanced=listener.progress, waiting=team.waiting)
    try:
        with inputs_kept(team, loaded.stamps):
            with clock.phase(Phase.MESH):
                inputs, frame = open_inputs(team, loaded)
            with prepare_session(team, inputs, listener, clock, frame) as session:
                measurement = session.measure(frame)
                noise_floor = session.estimate_noise_floor(measurement)
    except DdicError as error:
        keep_failed_run(team, error, Destination(output.file, output.flip_y), start, clock)
        raise
    summary = write_run(measurement, clock, output.file, noise_floor)
    remove_failed_field(team, output.file, start)
    return summary


def run_case(team: Team, path: Path, listener: Listener) -> Summary:
    """Run the case file of a pair, returning and raising what ``run_pair`` does; collective."""
    loaded = team.on_root(lambda: load_checked_case(path, team.size))
    if loaded.is_series:
        raise as_collective(InputError(f"{path}: images.deformed: names a series, one image is expected here"))
    with claimed_output(team, loaded.case.output.file):
        return run_pair(team, loaded, listener)


def run_file(team: Team, path: Path, listener: Listener, *, resume: bool = False) -> Summary | SeriesSummary:
    """Run a case file, whose summary is also written beside the result; collective.

    ``resume`` tells whether to go on with a series where an earlier run stopped. Raises DdicError on all ranks, as
    ``run_pair`` and ``run_series`` do.
    """
    loaded = team.on_root(lambda: load_checked_case(path, team.size))
    if resume and not loaded.is_series:
        raise as_collective(InputError(f"--resume: {path} has one deformed image, no series to go on with; leave "
                                       "--resume out"))
    with claimed_output(team, loaded.case.output.file):
        if loaded.is_series:
            from ddic.methods.series import run_series

            return run_series(team, loaded, listener, resume=resume)
        return run_pair(team, loaded, listener)
