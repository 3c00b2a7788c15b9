"""What a run leaves in its folder: a result with its summary, or the last field of one that did not converge."""

import json
import resource
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from ddic.errors import ConvergenceError, DdicError, InputError, WriteError, as_collective, is_collective
from ddic.io.input_file import find_real_path
from ddic.io.replace_on_exit import get_lock_path, held_output, note_unfinished, replaced_together
from ddic.io.result_schema import earlier_path, not_converged_path, summary_path
from ddic.io.result_writer import move_result, remove_result
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team
from ddic.results.publishable import Publishable
from ddic.results.publishing import Destination, gather_phase_times, publish
from ddic.results.summary import Summary, write_summary


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
                publish(measurement, Destination(file, output.flip_y, gather_phase_times(team, clock), noise_floor),
                        files)
            of_run = {**_describe_run(measurement, clock), "result_file": str(file), "noise_floor_px": noise_floor}
            summary = measurement.summarize(of_run)
            team.on_root(lambda: write_summary(summary_path(file), summary, files))
        except InputError as error:
            # It could be written when the case was checked: the inputs are not to blame.
            raise as_collective(WriteError(str(error))) from error
        team.build_on_root(stack.pop_all().close)
    return summary


def _describe_run(measurement: Publishable, clock: PhaseClock) -> dict[str, Any]:
    """What is told of any method, by field of the summary; collective."""
    team, inputs, size = measurement.team, measurement.inputs, measurement.size
    section = inputs.case.regularization
    memory = team.gather_lists([resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024])
    times = gather_phase_times(team, clock)
    return {
        "converged": not measurement.failure,
        "failure": measurement.failure,
        "n_dofs": size.n_unknowns,
        "n_subdomains": size.n_subdomains,
        "n_ranks": size.n_ranks,
        "seconds": times.seconds,
        "cpu_seconds": times.cpu_seconds,
        "imbalance": times.imbalance,
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
    """Keep other runs from a result's name while the block measures and writes it; collective.

    Raises InputError on all ranks where another run has it.
    """
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
    """Remove the field that an earlier run left when it did not converge; collective.

    It stays where it is ``start``, the earlier result that the case starts from.
    """
    path = not_converged_path(file)
    if start is None or find_real_path(path) != find_real_path(start):
        team.on_root(lambda: remove_result(path))


def keep_failed_run(team: Team, error: DdicError, destination: Destination, start: Path | None,
                    clock: PhaseClock | None = None) -> None:
    """Write what a failed run found, move an earlier result out of its way, and say both in the error; collective.

    Nothing is touched where the inputs were refused, or not all ranks know of the failure. ``start``, the earlier
    result that the case starts from, stays where no other field takes its place. With a clock a summary is written too.
    """
    file = destination.path
    if file is None or isinstance(error, InputError) or not is_collective(error):
        return
    last = _try(lambda: _write_last_field(team, error, destination, start, clock),
                "the last field could not be written")
    earlier = _try(lambda: team.on_root(lambda: _move_earlier_result(file)),
                   f"an earlier result could not be moved whole from {file}")
    error.args = ("; ".join([str(error), *last, *earlier]),)


def _try(work: Callable[[], list[str]], otherwise: str) -> list[str]:
    """What work says, or that it failed: the run's own failure is what is told first, for this one comes of it."""
    try:
        return work()
    except (OSError, DdicError) as second:
        if not is_collective(second):
            raise
        return [f"{otherwise} ({second})"]


def _write_last_field(team: Team, error: DdicError, destination: Destination, start: Path | None,
                      clock: PhaseClock | None) -> list[str]:
    """Write the field that an error brings; says where it is."""
    file = destination.path
    assert file is not None
    last = error.last if isinstance(error, ConvergenceError) else None
    if not isinstance(last, Publishable):
        remove_failed_field(team, file, start)
        return []
    path = not_converged_path(file)
    if clock is None:
        publish(last, replace(destination, path=path))
    else:
        write_run(last, clock, path)
    return [f"the last field, not converged, is in {path}"]


def _move_earlier_result(file: Path) -> list[str]:
    """Move an earlier result, lest it pass for this run's; says where it is."""
    if not file.is_file():
        return []
    target = earlier_path(file)
    move_result(file, target)
    return [f"an earlier result of the same name is now {target}"]
