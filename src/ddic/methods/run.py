"""A whole run: inputs checked, field measured, result and summary written."""

from __future__ import annotations

import resource
from pathlib import Path

from ddic.case.loader import LoadedCase, load_case
from ddic.case.schema import Case
from ddic.errors import InputError
from ddic.io.result_schema import summary_path
from ddic.methods.dd_dic import Measurement, dd_dic
from ddic.methods.near_far_dic import near_far_dic
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team
from ddic.problem.check_cameras import check_inputs
from ddic.results.listener import Listener
from ddic.results.near_attributes import near_summary
from ddic.results.phase_times import gather_phase_times
from ddic.results.publish import publish
from ddic.results.summary import Summary, write_summary


def run_case(team: Team, path: Path, listener: Listener) -> Summary:
    """Run a case file on all ranks of ``team``; returns the summary that is also written beside the result.

    Raises DdicError on all ranks; nothing is written unless the measurement converged.
    """
    loaded = team.on_root(lambda: _checked(path, team.size))
    clock = PhaseClock(entered=listener.phase, waiting=team.waiting)
    measure = near_far_dic if loaded.case.near else dd_dic
    measurement = measure(team, loaded.case, listener, clock)
    with clock.phase(Phase.WRITE):
        publish(team, loaded, measurement, gather_phase_times(team, clock))
    summary = summarize(team, loaded.case, measurement, clock)
    team.on_root(lambda: write_summary(summary_path(loaded.case.output.file), summary))
    return summary


def _checked(path: Path, n_ranks: int) -> LoadedCase:
    loaded = load_case(path)
    check_inputs(loaded)
    problem = rank_problem(loaded.case, n_ranks)
    if problem:
        raise InputError(f"{path}: {problem}")
    return loaded


def rank_problem(case: Case, n_ranks: int) -> str | None:
    """What is wrong with the number of ranks for this case, if anything."""
    solver = case.solver
    if solver.method == "monolithic":
        return None if n_ranks == 1 else (
            f'solver.method = "monolithic" runs on one rank, {n_ranks} were started; start one rank or use "dual"')
    largest = solver.subdomains if solver.blocks is None else solver.blocks[0] * solver.blocks[1]
    if largest is None or n_ranks <= largest:
        return None
    key = "solver.subdomains" if solver.blocks is None else "solver.blocks"
    return (f"{key}: {largest} subdomains for {n_ranks} MPI ranks, but every rank needs at least one; "
            f"start at most {largest} ranks or ask for more subdomains")


def summarize(team: Team, case: Case, measurement: Measurement, clock: PhaseClock) -> Summary:
    """Numbers for scripts; collective."""
    setting, grey = measurement.setting, measurement.grey[0]
    memory = team.gather_lists([resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024])
    times = gather_phase_times(team, clock)
    return Summary(
        converged=True,
        iterations=len(measurement.records),
        residual_std_grey=grey.residual_std,
        residual_percent_of_range=100 * grey.residual_std / setting.dynamic_range,
        n_dofs=setting.n_dofs,
        n_subdomains=setting.n_subdomains,
        n_ranks=setting.n_ranks,
        n_pixels=sum(camera.n_pixels for camera in measurement.grey),
        n_pixels_outside=setting.n_pixels - sum(camera.n_pixels for camera in measurement.grey),
        krylov_iterations=[r.krylov_iterations for r in measurement.records],
        seconds=times.seconds,
        cpu_seconds=times.cpu_seconds,
        imbalance=times.imbalance,
        peak_memory_bytes=memory,
        eta=setting.eta or None,
        cut_off_wavelength=None if case.regularization is None else case.regularization.cut_off_wavelength,
        largest_jump_px=measurement.field.largest_jump,
        linear_error_px=measurement.records[-1].linear_error,
        grey_correction=case.correlation.grey_correction,
        notes=measurement.notes,
        near=[near_summary(measurement, motion) for motion in measurement.motions],
        result_file=str(case.output.file),
    )
