"""A measurement and what it says of the material: beside a simulation, or with parameters that are sought."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ddic.case.loader import LoadedCase, load_case
from ddic.case.named_files import list_named_files
from ddic.case.schema import SimulationSection
from ddic.check.case import check_case, load_checked_case
from ddic.errors import DdicError, InputError, as_collective
from ddic.inputs.inputs import FrameOpener, inputs_kept, open_inputs
from ddic.io.input_file import FileStamps
from ddic.methods.dd_dic import DecomposedSession
from ddic.methods.run import claimed_output, keep_failed_run, remove_failed_field, write_run
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team
from ddic.problem.weighted_problem import WeightedProblem
from ddic.results.comparison import compare_with_simulation
from ddic.results.identification import identify_material
from ddic.results.listener import Listener, note_all
from ddic.results.measurement import Measurement
from ddic.results.summary import Summary


def compare_case(team: Team, path: Path, simulation: Mapping[str, Any], listener: Listener) -> Summary:
    """Measure a pair and compare it with a simulation; collective, returns the summary, also written.

    ``simulation`` has keys of the case's section that take the place of its own. Raises DdicError on all ranks.
    """
    loaded = team.on_root(lambda: _load_with_simulation(path, simulation, team.size))
    if loaded.is_series:
        raise as_collective(InputError(f"{path}: images.deformed: a simulation is compared with one image; name one"))
    return _run(team, loaded, listener, lambda problem, measured: compare_with_simulation(problem, measured[-1]))


def identify_case(team: Team, path: Path, listener: Listener) -> Summary:
    """Measure the frames of a case and identify the material; collective, returns the summary, also written.

    The result is that of the last frame. Raises DdicError on all ranks.
    """
    loaded = team.on_root(lambda: load_checked_case(path, team.size))
    if loaded.case.identification is None:
        raise as_collective(InputError(f"{path}: identification: this section is missing; it says which law is sought"))
    return _run(team, loaded, listener, identify_material)


def _load_with_simulation(path: Path, given: Mapping[str, Any], n_ranks: int) -> LoadedCase:
    """The case with what the command says of its simulation."""
    loaded = load_case(path)
    section = loaded.case.simulation
    if section is None and "file" not in given:
        raise InputError(f"{path}: simulation: this section is missing; it names the file, or give it to the command")
    kept = {} if section is None else {key: getattr(section, key) for key in section.model_fields_set}
    if set(given) & {"step", "time"}:
        kept = {key: value for key, value in kept.items() if key not in ("step", "time")}
    simulation = SimulationSection(**{**kept, **given})
    loaded = replace(loaded, case=loaded.case.model_copy(update={"simulation": simulation}))
    stamps = FileStamps.take(list_named_files(loaded.case, path.parent))
    check_case(loaded, n_ranks)
    return replace(loaded, stamps=stamps)


Look = Callable[[WeightedProblem, Sequence[Measurement]], Measurement]
"""What is said of the material, collectively, with the operators that found the last of some measured frames."""


def _run(team: Team, loaded: LoadedCase, listener: Listener, look: Look) -> Summary:
    """Measure, look at the material, and write; what fails leaves what ``run_pair`` leaves; collective."""
    output, start = loaded.case.output, loaded.case.start.from_result
    clock = PhaseClock(entered=listener.phase, advanced=listener.progress, waiting=team.waiting)
    with claimed_output(team, output.file):
        try:
            measurement, noise_floor = _measure(team, loaded, listener, clock, look)
        except DdicError as error:
            keep_failed_run(team, error, output.file, start, clock)
            raise
        summary = write_run(measurement, clock, output.file, noise_floor)
        remove_failed_field(team, output.file, start)
    return summary


def _measure(team: Team, loaded: LoadedCase, listener: Listener, clock: PhaseClock,
             look: Look) -> tuple[Measurement, float]:
    """The last frame with what is said of the material, and its noise floor, pixels; collective."""
    # Standard deviations come with the comparison.
    output = loaded.case.output.model_copy(update={"uncertainty": False})
    loaded = replace(loaded, case=loaded.case.model_copy(update={"output": output}))
    with inputs_kept(team, loaded.stamps):
        with clock.phase(Phase.MESH):
            inputs, first = open_inputs(team, loaded)
        opener = FrameOpener(team, inputs, 1, first, loaded.stamps)
        with DecomposedSession(team, inputs, listener, clock, first if opener.n_frames == 1 else None) as session:
            measurements: list[Measurement] = []
            for number in range(1, opener.n_frames + 1):
                if opener.n_frames > 1:
                    listener.frame(number, opener.n_frames, opener.describe(number))
                known = measurements[-1].unknowns if measurements else None
                measurements.append(session.measure(opener.open(number), known))
            with clock.phase(Phase.FINISH):
                n_notes = len(measurements[-1].notes)
                last = look(session.problem, measurements)
                note_all(listener, last.notes[n_notes:])
            return replace(last, inputs=last.inputs.with_frame(opener.n_frames - 1)), session.estimate_noise_floor(last)
