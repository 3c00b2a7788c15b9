"""A whole run of a pair: inputs opened, field measured, result and summary written."""

from __future__ import annotations

from ddic.case.loader import LoadedCase
from ddic.errors import DdicError
from ddic.inputs.inputs import inputs_kept, open_inputs
from ddic.methods.choose_recipe import prepare_recipe
from ddic.methods.detect import find_discontinuity, measure_on_lines
from ddic.methods.noise_floors import estimate_noise_floor
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team
from ddic.results.listener import Listener
from ddic.results.publishing import Destination
from ddic.results.run_files import keep_failed_run, remove_failed_field, write_run
from ddic.results.summary import Summary


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
        On all ranks. Where the measurement does not converge, its last field is written under a name that says so, and
        an earlier result is moved out of the way; the message says where both are.
    """
    output, start = loaded.case.output, loaded.case.start.from_result
    clock = PhaseClock(entered=listener.phase, advanced=listener.progress, waiting=team.waiting)
    try:
        with inputs_kept(team, loaded.stamps):
            with clock.phase(Phase.MESH):
                inputs, frame = open_inputs(team, loaded)
            inputs = find_discontinuity(team, inputs, frame, listener, clock)
            recipe = prepare_recipe(team, inputs, listener, clock, frame)
            try:
                recipe, inputs, measurement = measure_on_lines(
                    recipe, inputs, frame, None, lambda refined: prepare_recipe(team, refined, listener, clock, frame),
                    listener, clock)
                noise_floor = estimate_noise_floor(recipe, measurement, clock)
            finally:
                recipe.close()
    except DdicError as error:
        keep_failed_run(team, error, Destination(output.file, output.flip_y), start, clock)
        raise
    summary = write_run(measurement, clock, output.file, noise_floor)
    remove_failed_field(team, output.file, start)
    return summary

