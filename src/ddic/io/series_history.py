"""What the frames of a series come to over time: displacements, strains, residuals, iterations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.io import result_schema as schema
from ddic.io.result_reader import Result
from ddic.io.series_reader import SeriesResult
from ddic.mesh.mesh import Mesh
from ddic.mesh.quality import measure_covered_areas

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SeriesHistory:
    """Numbers of the frames of a series; nan for those that were not measured.

    Attributes
    ----------
    times : (n,) array
        Unit chosen by the user.
    is_measured : (n,) array of bool
        Of each frame.
    lowest, highest, rms : (n, 2) array
        Displacement components of measured nodes, pixels.
    principal_strains : (n, 2) array
        Means over the area of the measured specimen, the larger one first; of the logarithmic strain.
    residual : (n,) array
        Standard deviation, grey levels.
    noise_floor : (n,) array
        RMS displacement, pixels.
    iterations : (n,) array
        Of Gauss-Newton.
    """

    times: Array
    is_measured: NDArray[np.bool_]
    lowest: Array
    highest: Array
    rms: Array
    principal_strains: Array
    residual: Array
    noise_floor: Array
    iterations: Array


def gather_history(series: SeriesResult) -> SeriesHistory:
    """Gather what the frames of a series come to; they are read one after the other.

    Parameters
    ----------
    series : SeriesResult
        Of at least one frame.

    Returns
    -------
    SeriesHistory
        Of all frames, measured or not.
    """
    records = series.records
    is_measured = np.isin([record["number"] for record in records], series.numbers)
    sizes = np.full((len(records), 4, 2), np.nan)
    for place, result in zip(np.flatnonzero(is_measured), series, strict=True):
        sizes[place] = _measure_sizes(result)

    def list_numbers(key: str) -> Array:
        known = [record.get(key) if measured else None for record, measured in zip(records, is_measured, strict=True)]
        return np.array([np.nan if value is None else value for value in known], float)

    return SeriesHistory(
        times=np.array([record["time"] for record in records], float), is_measured=is_measured, lowest=sizes[:, 0],
        highest=sizes[:, 1], rms=sizes[:, 2], principal_strains=sizes[:, 3],
        residual=list_numbers("residual_std_grey"), noise_floor=list_numbers("noise_floor_px"),
        iterations=list_numbers("iterations"))


def _measure_sizes(result: Result) -> Array:
    """Least, largest and RMS displacement and the mean principal strains, (4, 2); nan where nothing was measured."""
    displacement = result.displacement[result.measured_nodes]
    if not len(displacement):
        return np.full((4, 2), np.nan)
    strains = [_average(result.mesh, result.point_data[name])
               for name in (schema.NODAL_PRINCIPAL_1, schema.NODAL_PRINCIPAL_2)]
    return np.array([displacement.min(axis=0), displacement.max(axis=0), np.sqrt((displacement**2).mean(axis=0)),
                     strains])


def _average(mesh: Mesh, values: Array) -> float:
    """Mean of values at nodes (n_nodes,) over the area of the cells that know them all."""
    areas, _ = measure_covered_areas(mesh)
    of_cells = np.add.reduceat(values[mesh.connectivity], mesh.offsets[:-1]) / np.diff(mesh.offsets)
    is_known = np.isfinite(of_cells)
    return float((areas * of_cells)[is_known].sum() / areas[is_known].sum()) if is_known.any() else float("nan")
