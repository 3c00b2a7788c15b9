"""The summary of a measurement."""

from __future__ import annotations

import resource

from ddic.parallel.phases import PhaseClock
from ddic.results.measurement import Measurement
from ddic.results.near_attributes import summarize_near_field
from ddic.results.phase_times import gather_phase_times
from ddic.results.separated_measurement import SeparatedMeasurement
from ddic.results.summary import Summary


def summarize(measurement: Measurement | SeparatedMeasurement, clock: PhaseClock) -> Summary:
    """Sum up a measurement in numbers for scripts and people; collective.

    Parameters
    ----------
    measurement : Measurement or SeparatedMeasurement
        What was measured.
    clock : PhaseClock
        This rank's.

    Returns
    -------
    Summary
        The same on all ranks.
    """
    if isinstance(measurement, SeparatedMeasurement):
        return _summarize_separated(measurement, clock)
    team, case, size = measurement.team, measurement.inputs.case, measurement.size
    grey = measurement.evaluation.grey
    memory = team.gather_lists([resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024])
    times = gather_phase_times(team, clock)
    n_pixels = sum(camera.n_pixels for camera in grey)
    return Summary(
        converged=True,
        iterations=len(measurement.records),
        residual_std_grey=grey[0].residual_std,
        residual_percent_of_range=100 * grey[0].residual_std / size.dynamic_range,
        n_dofs=size.n_unknowns,
        n_subdomains=size.n_subdomains,
        n_ranks=size.n_ranks,
        n_pixels=n_pixels,
        n_pixels_outside=size.n_pixels - n_pixels,
        krylov_iterations=[record.krylov_iterations for record in measurement.records],
        seconds=times.seconds,
        cpu_seconds=times.cpu_seconds,
        imbalance=times.imbalance,
        peak_memory_bytes=memory,
        eta=size.eta or None,
        cut_off_wavelength=None if case.regularization is None else case.regularization.cut_off_wavelength,
        largest_jump_px=measurement.largest_jump,
        linear_error_px=measurement.records[-1].linear_error,
        grey_correction=measurement.model.correction,
        notes=measurement.notes,
        near=[summarize_near_field(measurement, motion) for motion in measurement.motions],
        result_file=str(case.output.file),
        stop=measurement.stop,
        half_amplitudes=size.half_amplitudes,
    )


def _summarize_separated(measurement: SeparatedMeasurement, clock: PhaseClock) -> Summary:
    team, case, size, solution = measurement.team, measurement.inputs.case, measurement.size, measurement.solution
    memory = team.gather_lists([resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024])
    times = gather_phase_times(team, clock)
    return Summary(
        converged=True,
        iterations=len(solution.records),
        residual_std_grey=solution.grey.residual_std,
        residual_percent_of_range=100 * solution.grey.residual_std / (size.dynamic_range or 1.0),
        n_dofs=size.n_unknowns,
        n_subdomains=size.n_subdomains,
        n_ranks=size.n_ranks,
        n_pixels=solution.grey.n_pixels,
        n_pixels_outside=size.n_pixels - solution.grey.n_pixels,
        krylov_iterations=[],
        seconds=times.seconds,
        cpu_seconds=times.cpu_seconds,
        imbalance=times.imbalance,
        peak_memory_bytes=memory,
        eta=size.eta or None,
        cut_off_wavelength=None if case.regularization is None else case.regularization.cut_off_wavelength,
        largest_jump_px=0.0,
        linear_error_px=float("nan"),
        grey_correction=case.correlation.grey_correction,
        notes=measurement.notes,
        result_file=str(case.output.file),
        stop=solution.stop,
        half_amplitudes=size.half_amplitudes,
        n_modes=solution.field.n_modes,
    )
