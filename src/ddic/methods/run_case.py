"""A whole run of a pair: inputs checked, field measured, result and summary written."""

from __future__ import annotations

from pathlib import Path

from ddic.case.frame_files import is_series
from ddic.case.loader import LoadedCase
from ddic.errors import DdicError, InputError, as_collective
from ddic.methods.choose_recipe import estimate_noise_floor, prepare_recipe
from ddic.methods.detect import find_discontinuity
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team
from ddic.problem.check_ranks import load_checked_case
from ddic.problem.inputs import open_inputs
from ddic.results.listener import Listener
from ddic.results.publishing import Destination
from ddic.results.run_files import keep_failed_run, remove_failed_field, write_run
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
    return run_pair(team, team.on_root(lambda: load_checked_case(path, team.size)), listener)


def run_pair(team: Team, loaded: LoadedCase, listener: Listener) -> Summary:
    """Run a case that was loaded; collective.

    Parameters
    ----------
    team : Team
        All ranks.
    loaded : LoadedCase
        Checked, with one deformed image of each camera.
    listener : Listener
        Told what happens.

    Returns
    -------
    Summary
        Also written beside the result.

    Raises
    ------
    DdicError
        As ``run_case`` does.
    """
    if is_series(loaded.case):
        raise as_collective(InputError(f"{loaded.path}: images.deformed: names a series, one image is expected here"))
    output, start = loaded.case.output, loaded.case.start.from_result
    clock = PhaseClock(entered=listener.phase, advanced=listener.progress, waiting=team.waiting)
    try:
        with clock.phase(Phase.MESH):
            inputs, frame = open_inputs(team, loaded)
        inputs = find_discontinuity(team, inputs, frame, listener, clock)
        with prepare_recipe(team, inputs, listener, clock, frame) as recipe:
            measurement = recipe.measure(frame)
            noise_floor = estimate_noise_floor(recipe, measurement, clock)
    except DdicError as error:
        keep_failed_run(team, error, Destination(output.file, output.flip_y), start, clock)
        raise
    summary = write_run(measurement, clock, output.file, noise_floor)
    remove_failed_field(team, output.file, start)
    return summary

