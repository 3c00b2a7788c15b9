"""A whole run: inputs checked, field measured, result and summary written."""

from __future__ import annotations

from pathlib import Path

from ddic.io.result_schema import summary_path
from ddic.methods.choose_recipe import prepare_recipe
from ddic.methods.detect import find_discontinuity
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team
from ddic.problem.check_ranks import load_checked_case
from ddic.problem.inputs import open_inputs
from ddic.results.listener import Listener
from ddic.results.phase_times import gather_phase_times
from ddic.results.publishing import Destination, publish
from ddic.results.summarize import summarize
from ddic.results.summary import Summary, write_summary


def run_case(team: Team, path: Path, listener: Listener) -> Summary:
    """Run a case file; collective.

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
        On all ranks; nothing is written unless the measurement converged.
    """
    loaded = team.on_root(lambda: load_checked_case(path, team.size))
    output = loaded.case.output
    clock = PhaseClock(entered=listener.phase, waiting=team.waiting)
    with clock.phase(Phase.MESH):
        inputs, frame = open_inputs(team, loaded)
    inputs = find_discontinuity(team, inputs, frame, listener, clock)
    with prepare_recipe(team, inputs, listener, clock, frame) as recipe:
        measurement = recipe.measure(frame)
    with clock.phase(Phase.WRITE):
        publish(measurement, Destination(output.file, output.flip_y, gather_phase_times(team, clock)))
    summary = summarize(measurement, clock)
    team.on_root(lambda: write_summary(summary_path(output.file), summary))
    return summary

