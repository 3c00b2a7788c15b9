"""Tables and attributes of a PGD-DIC measurement in the result file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ddic.io import result_schema as schema
from ddic.io.result_writer import ResultWriter

if TYPE_CHECKING:
    from ddic.results.separated_measurement import SeparatedMeasurement


def write_separated_tables(measurement: SeparatedMeasurement, writer: ResultWriter) -> None:
    """Write the table of corrections, the case, times and units; on rank 0.

    Parameters
    ----------
    measurement : SeparatedMeasurement
        What was measured.
    writer : ResultWriter
        Open.
    """
    writer.write_table(schema.CORRECTIONS, list_corrections(measurement))
    inputs, size = measurement.inputs, measurement.size
    images = inputs.case.images
    writer.write_attributes(schema.CASE, {
        "path": str(inputs.case_path), "toml": inputs.case_text, "json": inputs.case.model_dump_json(),
        "eta": size.eta, "largest_jump_px": 0.0, "stop": measurement.solution.stop,
    })
    writer.write_attributes(schema.TIME, {"reference": images.reference_time, "deformed": images.deformed_time})
    writer.write_attributes(schema.UNITS, {"pixel_size": images.pixel_size or 1.0, "length_unit": images.length_unit})
    if size.half_amplitudes is not None:
        writer.write_attributes(schema.CASE, {"half_amplitude_shear_px": size.half_amplitudes.shear,
                                              "half_amplitude_longitudinal_px": size.half_amplitudes.longitudinal})


def list_corrections(measurement: SeparatedMeasurement) -> dict[str, list[Any]]:
    """List the corrections of PGD-DIC.

    Parameters
    ----------
    measurement : SeparatedMeasurement
        What was measured.

    Returns
    -------
    dict of list
        Columns of their table, by name; the residual is that before each correction.
    """
    records = measurement.solution.records
    return {
        "correction": [r.number for r in records],
        "rms_x_px": [r.rms[0] for r in records],
        "rms_y_px": [r.rms[1] for r in records],
        "relative_x": [r.relative[0] for r in records],
        "relative_y": [r.relative[1] for r in records],
        "fluctuation_x": [r.fluctuation[0] for r in records],
        "fluctuation_y": [r.fluctuation[1] for r in records],
        "gain": [r.gain for r in records],
        "noise_gain": [r.noise_gain for r in records],
        "sweeps": [r.n_sweeps for r in records],
        "modes": [r.n_modes for r in records],
        "residual_std_grey": [r.grey.residual_std for r in records],
        "residual_rms_grey": [r.grey.residual_rms for r in records],
        "n_pixels": [r.grey.n_pixels for r in records],
        "grey_gain": [r.grey.gain for r in records],
        "grey_offset": [r.grey.offset for r in records],
    }
