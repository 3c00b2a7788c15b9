"""A whole run of a case file, of a pair or of a series, and what it leaves in its folder."""

import json
import math
import resource
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ddic.case.loader import LoadedCase
from ddic.check.case import load_checked_case
from ddic.errors import (
    ConvergenceError,
    DdicError,
    InputError,
    WriteError,
    as_collective,
    is_collective,
    require_collective,
)
from ddic.inputs.inputs import inputs_kept, open_inputs
from ddic.io import result_schema as schema
from ddic.io.input_file import find_real_path
from ddic.io.replace_on_exit import get_lock_path, held_output, note_unfinished, replaced_together
from ddic.io.result_writer import ResultWriter, move_result, remove_result
from ddic.methods.method import prepare_session
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team
from ddic.results.listener import Listener
from ddic.results.publishing import Publishable, publish
from ddic.results.summary import SeriesSummary, Summary, write_summary


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
        keep_failed_run(team, error, output.file, start, clock)
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


@dataclass(frozen=True)
class _PhaseTimes:
    """Seconds by phase, in the order in which phases began.

    Wall seconds are the slowest rank's, CPU seconds those of all ranks. The imbalance is busy seconds of the busiest
    rank over their mean, from 1 (all have the same to do) to the number of ranks (one does it all). Busy are CPU
    seconds that are not spent in a team's communication; what a rank waits inside PETSc counts as busy.
    """

    seconds: dict[Phase, float]
    cpu_seconds: dict[Phase, float]
    imbalance: dict[Phase, float]


def gather_phase_times(team: Team, clock: PhaseClock) -> _PhaseTimes:
    """Gather what the clocks of all ranks have so far, of the phases that this rank has had; collective."""
    clocks = team.gather_lists([(clock.wall, clock.cpu, clock.busy)])
    seconds, cpu_seconds, imbalance = {}, {}, {}
    for phase in clock.wall:
        seconds[phase] = max(wall.get(phase, 0.0) for wall, _, _ in clocks)
        cpu_seconds[phase] = sum(cpu.get(phase, 0.0) for _, cpu, _ in clocks)
        busy = [of_rank.get(phase, 0.0) for _, _, of_rank in clocks]
        mean = sum(busy) / len(busy)
        imbalance[phase] = max(busy) / mean if mean > 0 else 1.0
    return _PhaseTimes(seconds, cpu_seconds, imbalance)


def write_run(measurement: Publishable, clock: PhaseClock, file: Path, noise_floor: float = float("nan")) -> Summary:
    """Write a result, converged or not, and its summary, the same on all ranks; collective.

    ``noise_floor`` is the RMS displacement that the images' noise leaves, pixels; nan where it is not known. Raises
    OSError or WriteError on all ranks where one of them cannot be written; neither is then, and an earlier one stays.
    """
    team, output = measurement.team, measurement.inputs.case.output
    with ExitStack() as stack:
        files = team.build_on_root(lambda: stack.enter_context(replaced_together()))
        try:
            with clock.phase(Phase.WRITE):
                times = gather_phase_times(team, clock)
                publish(measurement, file, files, flip_y=output.flip_y,
                        add=lambda writer: write_times(writer, times, noise_floor))
            of_run = {**_describe_run(measurement, clock), "result_file": str(file), "noise_floor_px": noise_floor}
            summary = measurement.summarize(of_run)
            team.on_root(lambda: write_summary(schema.summary_path(file), summary, files))
        except InputError as error:
            # It could be written when the case was checked: the inputs are not to blame.
            raise as_collective(WriteError(str(error))) from error
        team.build_on_root(stack.pop_all().close)
    return summary


def write_times(writer: ResultWriter, times: _PhaseTimes, noise_floor: float = float("nan")) -> None:
    """Write the seconds by phase so far, and what noise leaves where it is known; on rank 0."""
    columns = {name: list(by_phase.values()) for name, by_phase in asdict(times).items()}
    writer.write_table(schema.PHASES, {"phase": [str(phase) for phase in times.seconds], **columns})
    if not math.isnan(noise_floor):
        writer.write_attributes(schema.CASE, {schema.NOISE_FLOOR: noise_floor})


def _describe_run(measurement: Publishable, clock: PhaseClock) -> dict[str, Any]:
    """What is told of any method, by field of the summary; collective."""
    team, inputs, size = measurement.team, measurement.inputs, measurement.size
    section = inputs.case.regularization
    memory = team.gather_lists([resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024])
    return {
        "converged": not measurement.failure,
        "failure": measurement.failure,
        "verdict": measurement.verdict,
        "n_dofs": size.n_unknowns,
        "n_subdomains": size.n_subdomains,
        "n_ranks": size.n_ranks,
        **asdict(gather_phase_times(team, clock)),
        "peak_memory_bytes": memory,
        "eta": size.eta or None,
        "cut_off_wavelength": None if section is None else section.cut_off_wavelength,
        "grey_correction": measurement.grey_correction,
        "notes": measurement.notes,
        "half_amplitudes": size.half_amplitudes,
        "images": _list_images(measurement),
        "case": {"path": str(inputs.case_path), **json.loads(inputs.asked_case.model_dump_json())},
    }


def _list_images(measurement: Publishable) -> dict[str, str]:
    """Paths of all cameras' images, by what they are."""
    paths = {}
    for camera, deformed in zip(measurement.inputs.cameras, measurement.frame, strict=True):
        prefix = f"near_{camera.number}_" if camera.number else ""
        paths[f"{prefix}reference"] = str(camera.reference.image.path)
        paths[f"{prefix}deformed"] = str(deformed.image.path)
    return paths


@contextmanager
def claimed_output(team: Team, file: Path) -> Iterator[None]:
    """Keep others from a result's name during the block; collective, raises InputError on all ranks if a run has it."""
    with ExitStack() as stack:
        team.build_on_root(lambda: stack.enter_context(held_output(file)))
        try:
            yield
        except BaseException as error:
            if not is_collective(error):
                # This rank ends all others: rank 0 may wait inside MPI, see no signal, and leave its lock.
                note_unfinished(get_lock_path(file))
            raise


def remove_failed_field(team: Team, file: Path, start: Path | None) -> None:
    """Remove the field that an earlier run left unconverged, unless the case starts from it, ``start``; collective."""
    path = schema.not_converged_path(file)
    if start is None or find_real_path(path) != find_real_path(start):
        team.on_root(lambda: remove_result(path))


def keep_failed_run(team: Team, error: DdicError, file: Path | None, start: Path | None,
                    clock: PhaseClock | None = None) -> None:
    """Write what a failed run found, move an earlier result out of its way, and say both in the error; collective.

    Nothing is touched where no ``file`` was to be written, the inputs were refused, or not all ranks know of the
    failure. ``start``, the earlier result that the case starts from, stays where no other field takes its place. With a
    clock a summary is written too.
    """
    if file is None or isinstance(error, InputError) or not is_collective(error):
        return
    last = _try(lambda: _write_last_field(team, error, file, start, clock), "the last field could not be written")
    earlier = _try(lambda: team.on_root(lambda: _move_earlier_result(file)),
                   f"an earlier result could not be moved whole from {file}")
    error.args = ("; ".join([str(error), *last, *earlier]),)


def _try(work: Callable[[], list[str]], otherwise: str) -> list[str]:
    """What work says, or that it failed: the run's own failure is what is told first, for this one comes of it."""
    try:
        return work()
    except (OSError, DdicError) as second:
        require_collective(second)
        return [f"{otherwise} ({second})"]


def _write_last_field(team: Team, error: DdicError, file: Path, start: Path | None,
                      clock: PhaseClock | None) -> list[str]:
    """Write the field that an error brings; says where it is."""
    last = error.last if isinstance(error, ConvergenceError) else None
    if not isinstance(last, Publishable):
        remove_failed_field(team, file, start)
        return []
    path = schema.not_converged_path(file)
    if clock is None:
        publish(last, path, flip_y=last.inputs.case.output.flip_y)
    else:
        write_run(last, clock, path)
    return [f"the last field, not converged, is in {path}"]


def _move_earlier_result(file: Path) -> list[str]:
    """Move an earlier result, lest it pass for this run's; says where it is."""
    if not file.is_file():
        return []
    target = schema.earlier_path(file)
    move_result(file, target)
    return [f"an earlier result of the same name is now {target}"]
