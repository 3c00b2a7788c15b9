"""The summary of a measurement."""

from __future__ import annotations

import json
import resource
from typing import TYPE_CHECKING, Any

from ddic.io import result_schema as schema
from ddic.parallel.phases import PhaseClock
from ddic.results.histories import list_corrections, list_iterations
from ddic.results.measurement import Measurement
from ddic.results.near import summarize_near_field
from ddic.results.publishing import gather_phase_times
from ddic.results.summary import Summary, find_field_ranges

if TYPE_CHECKING:
    from ddic.results.separated import SeparatedMeasurement


def summarize(measurement: Measurement | SeparatedMeasurement, clock: PhaseClock) -> Summary:
    """Sum up a measurement in numbers for scripts and people, the same on all ranks; collective."""
    shared = _summarize_run(measurement, clock)
    if not isinstance(measurement, Measurement):
        return _summarize_separated(measurement, shared)
    grey, size, records = measurement.evaluation.grey, measurement.size, measurement.records
    n_pixels = sum(camera.n_pixels for camera in grey)
    fields = zip((subdomain.mesh for subdomain in measurement.subdomains), measurement.displacements, strict=True)
    return Summary(
        **shared,
        iterations=measurement.n_iterations,
        local_iterations=len(records) - measurement.n_iterations,
        residual_std_grey=grey[0].residual_std,
        residual_percent_of_range=100 * grey[0].residual_std / size.dynamic_range,
        n_pixels=n_pixels,
        n_pixels_outside=size.n_pixels - n_pixels,
        krylov_iterations=[record.krylov_iterations for record in records],
        largest_jump_px=measurement.largest_jump,
        linear_error_px=records[-1].linear_error if records else float("nan"),
        near=[summarize_near_field(measurement, motion) for motion in measurement.motions],
        stop=measurement.stop,
        method=measurement.method,
        preconditioner=measurement.preconditioner,
        ranges=find_field_ranges(measurement.team, list(fields)),
        iteration_table=list_iterations(measurement),
    )


def _summarize_separated(measurement: SeparatedMeasurement, shared: dict[str, Any]) -> Summary:
    team, size, solution = measurement.team, measurement.size, measurement.solution
    mesh, u = measurement.cells.build_mesh(), measurement.cells.evaluate_displacement(solution.field)
    return Summary(
        **shared,
        iterations=len(solution.records),
        residual_std_grey=solution.grey.residual_std,
        residual_percent_of_range=100 * solution.grey.residual_std / (size.dynamic_range or 1.0),
        n_pixels=solution.grey.n_pixels,
        n_pixels_outside=size.n_pixels - solution.grey.n_pixels,
        krylov_iterations=[],
        largest_jump_px=0.0,
        linear_error_px=float("nan"),
        stop=solution.stop,
        n_modes=solution.field.n_modes,
        method=schema.PGD,
        ranges=find_field_ranges(team, [(mesh, u.ravel())]),
        iteration_table=list_corrections(measurement),
    )


def _summarize_run(measurement: Measurement | SeparatedMeasurement, clock: PhaseClock) -> dict[str, Any]:
    """What is told of any method, by field of the summary; collective."""
    team, inputs, size = measurement.team, measurement.inputs, measurement.size
    case = inputs.case
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
        "cut_off_wavelength": None if case.regularization is None else case.regularization.cut_off_wavelength,
        "grey_correction": measurement.grey_correction,
        "notes": measurement.notes,
        "result_file": str(case.output.file),
        "half_amplitudes": size.half_amplitudes,
        "images": _list_images(measurement),
        "case": {"path": str(inputs.case_path), **json.loads(inputs.asked_case.model_dump_json())},
    }


def _list_images(measurement: Measurement | SeparatedMeasurement) -> dict[str, str]:
    """Paths of all cameras' images, by what they are."""
    paths = {}
    for camera, deformed in zip(measurement.cameras, measurement.frame, strict=True):
        prefix = f"near_{camera.number}_" if camera.number else ""
        paths[f"{prefix}reference"] = str(camera.reference.image.path)
        paths[f"{prefix}deformed"] = str(deformed.image.path)
    return paths
