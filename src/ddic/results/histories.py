"""Tables, curves and attributes of a measurement in the result file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ddic.io import result_schema as schema
from ddic.io.result_writer import ResultWriter
from ddic.results.near import describe_near_field
from ddic.results.publishable import Publishable

if TYPE_CHECKING:
    from ddic.results.measurement import Measurement


def write_histories(measurement: Measurement, writer: ResultWriter) -> None:
    """Write the table of Gauss-Newton's iterations and the Krylov residuals of each; on rank 0."""
    writer.write_table(schema.GAUSS_NEWTON, list_iterations(measurement))
    writer.write_curves(schema.KRYLOV, [r.krylov_history for r in measurement.records])


def list_iterations(measurement: Measurement) -> dict[str, list[Any]]:
    """List Gauss-Newton's iterations, columns by name; the residual is that before each correction."""
    records = measurement.records
    columns: dict[str, list[Any]] = {
        "iteration": [r.number for r in records],
        "relative_correction": [r.size.relative for r in records],
        "rms_correction_px": [r.size.rms for r in records],
        "largest_correction_px": [r.size.largest for r in records],
        "slow_nodes": [r.size.n_slow for r in records],
        "of_slow_nodes": [int(r.is_local) for r in records],
        "residual_std_grey": [r.grey.residual_std for r in records],
        "residual_rms_grey": [r.grey.residual_rms for r in records],
        "n_pixels": [r.grey.n_pixels for r in records],
        "gain": [r.grey.gain for r in records],
        "offset": [r.grey.offset for r in records],
    }
    for camera in measurement.cameras[1:]:
        columns[f"near_{camera.number}_residual_std_grey"] = [r.cameras[camera.number].residual_std for r in records]
    columns["krylov_iterations"] = [r.krylov_iterations for r in records]
    columns["linear_error_px"] = [r.linear_error for r in records]
    return columns


def write_attributes(measurement: Measurement, writer: ResultWriter) -> None:
    """Write the case, the times and units, and what is known of near-field set-ups; on rank 0."""
    write_case(measurement, writer, {"largest_jump_px": measurement.largest_jump,
                                     "notes": "\n".join(measurement.inputs.notes)})
    if measurement.uncertainty is not None:
        from ddic.results.field_uncertainty import list_uncertainty

        writer.write_attributes(schema.UNCERTAINTY, list_uncertainty(measurement.uncertainty))
    for motion in measurement.motions:
        writer.write_attributes(schema.near_group(motion.camera), describe_near_field(measurement, motion))


def write_case(measured: Publishable, writer: ResultWriter, of_method: dict[str, Any]) -> None:
    """Write the case with what a method has to say beside it, and the times and units; on rank 0."""
    inputs, size = measured.inputs, measured.size
    images = inputs.case.images
    writer.write_attributes(schema.CASE, {
        "path": str(inputs.case_path), "toml": inputs.case_text, "json": inputs.asked_case.model_dump_json(),
        "eta": size.eta, **of_method,
    })
    writer.write_attributes(schema.TIME, {"reference": images.reference_time, "deformed": images.deformed_time})
    writer.write_attributes(schema.UNITS, {"pixel_size": images.pixel_size or 1.0, "length_unit": images.length_unit})
    if size.half_amplitudes is not None:
        writer.write_attributes(schema.CASE, {"half_amplitude_shear_px": size.half_amplitudes.shear,
                                              "half_amplitude_longitudinal_px": size.half_amplitudes.longitudinal})
