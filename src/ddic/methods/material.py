"""A measurement and what it says beyond its field: beside a simulation, of a material's parameters, of a series."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ddic.case.loader import LoadedCase, load_case
from ddic.case.named_files import list_deformed, list_named_files, list_times
from ddic.case.schema import Case, SimulationSection
from ddic.check.case import check_case, load_checked_case
from ddic.errors import DdicError, InputError, as_collective
from ddic.identification.joint_step import MaterialModel
from ddic.inputs.inputs import FrameOpener, inputs_kept, open_inputs
from ddic.io.input_file import FileStamps
from ddic.mesh.mesh import Mesh
from ddic.methods.dd_dic import DecomposedSession
from ddic.methods.run import claimed_output, keep_failed_run, remove_failed_field, write_run
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team
from ddic.problem.weighted_problem import WeightedProblem
from ddic.results.comparison import compare_with_simulation
from ddic.results.identification import identify_material
from ddic.results.listener import Listener, note_all
from ddic.results.measurement import Measurement
from ddic.results.modes import find_modes
from ddic.results.summary import Summary


def compare_case(team: Team, path: Path, simulation: Mapping[str, Any], listener: Listener) -> Summary:
    """Measure a pair and compare it with a simulation; collective, returns the summary, also written.

    ``simulation`` has keys of the case's section that take the place of its own. Raises DdicError on all ranks.
    """
    loaded = team.on_root(lambda: _load_with_simulation(path, simulation, team.size))
    if loaded.is_series:
        raise as_collective(InputError(f"{path}: images.deformed: a simulation is compared with one image; name one"))
    return _run(team, loaded, listener, lambda problem, measured: compare_with_simulation(problem, measured[-1]))


def identify_case(team: Team, path: Path, listener: Listener,
                  build: Callable[[Case, Mesh], MaterialModel] | None = None) -> Summary:
    """Measure the frames of a case and identify the material; collective, returns the summary, also written.

    The result is that of the last frame; ``build`` makes a model of one's own on a mesh. Raises DdicError on all ranks.
    """
    loaded = team.on_root(lambda: load_checked_case(path, team.size))
    if loaded.case.identification is None and build is None:
        raise as_collective(InputError(f"{path}: identification: this section is missing; it says which law is sought"))
    return _run(team, loaded, listener, lambda problem, measured: identify_material(problem, measured, build))


def measure_modes(team: Team, path: Path, n_modes: int | None, listener: Listener) -> Summary:
    """Measure the frames of a series together, as few modes; collective, returns the summary, also written.

    The result is that of the last frame, with the modes. ``n_modes`` is found from the noise where it is None. Raises
    DdicError on all ranks.
    """
    loaded = team.on_root(lambda: load_checked_case(path, team.size))
    case, n_frames = loaded.case, len(list_deformed(loaded.case.imaging))
    if n_frames < 1 + (n_modes or 2):
        raise as_collective(InputError(f"{path}: images.deformed: {n_frames} images are too few for modes of a series; "
                                       "name more of them, or ask for fewer modes"))
    return _run(team, loaded, listener,
                lambda problem, measured: find_modes(problem, measured, list_times(case), n_modes))


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
    _refuse_what_run_alone_knows(loaded)
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


def _refuse_what_run_alone_knows(loaded: LoadedCase) -> None:
    """Refuse, with an InputError on all ranks, kinematics and laws with which nothing more than a field is measured."""
    case = loaded.case
    is_plastic = case.regularization is not None and case.regularization.yield_strain is not None
    for what, is_given in {"[[near]]": bool(case.near), "[[discontinuity]]": bool(case.discontinuity),
                           "[pgd]": case.pgd is not None, "regularization.yield_strain": is_plastic,
                           "series.groups": case.series.groups > 1,
                           "series.incremental": case.series.incremental != "never"}.items():
        if is_given:
            raise as_collective(InputError(f"{loaded.path}: {what} goes with ddic run alone; leave it out"))


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
