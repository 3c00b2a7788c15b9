"""Tables of what probes read over time, with the resolution and the noise of each, and of whole fields."""

import csv
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array
from ddic.io import result_schema as schema
from ddic.io.mesh_file import convert_to_meshio
from ddic.io.replace_on_exit import replaced_on_exit, replaced_together
from ddic.io.result_reader import Result, clip_result
from ddic.mesh.interpolation import locate
from ddic.plots.canvas import LengthUnit, find_length_unit
from ddic.probes.metrology import Metrology, estimate_metrology
from ddic.probes.probes import KINDS, LineProbe, Measure, PointProbe, Probe, Reading, list_samples, measure_probe

N_DIGITS = 9
"""Of numbers in a table: displacements have no more."""


@dataclass(frozen=True, eq=False)
class ProbeRecord:
    """What one probe reads on one result.

    Attributes
    ----------
    time : float
        Of the deformed image, as the case gives it.
    result : str
        Name of the result's file.
    reading : Reading
        Values.
    metrology : Metrology
        Spatial resolution and noise floor.
    unit : LengthUnit
        Of lengths, where they are written.
    """

    time: float
    result: str
    reading: Reading
    metrology: Metrology
    unit: LengthUnit


def measure_probes(results: Iterable[Result], probes: Sequence[Probe], measure: Measure = "infinitesimal",
                   noise: float | None = None) -> list[ProbeRecord]:
    """Read probes on results in the order of their times.

    Parameters
    ----------
    results : iterable of Result
        One in a list, or the frames of a series, which are read one after the other.
    probes : sequence of Probe
        Where and how.
    measure : {"infinitesimal", "green-lagrange", "hencky"}, optional
        Tensor of the strain.
    noise : float, optional
        Standard deviation of a component of the nodes' displacements, pixels; by default what the results say.

    Returns
    -------
    list of ProbeRecord
        All probes at the first time, then at the next one.
    """
    records = []
    for result in results:
        # That of the deformed image, as the case gives it; nan where the file says none.
        time = float(result.attributes.get(schema.TIME, {}).get("deformed", math.nan))
        for probe in probes:
            near = _clip_to(result, probe)
            records.append(ProbeRecord(time, result.path.name, measure_probe(near, probe, measure),
                                       estimate_metrology(near, probe, noise), find_length_unit(result)))
    return sorted(records, key=lambda record: record.time)


def _clip_to(result: Result, probe: Probe) -> Result:
    """The cells about a probe; of one that lies in none, all, whose mean spacing is its."""
    samples = list_samples(result, probe)
    near = clip_result(result, samples.min(axis=0), samples.max(axis=0))
    return near if (locate(near.mesh, samples).cells >= 0).any() else result


def write_probe_table(path: Path | str, records: Sequence[ProbeRecord]) -> None:
    """Write what probes read as CSV: a row for each time, probe and place, units in the header.

    Parameters
    ----------
    path : Path or str
        The file.
    records : sequence of ProbeRecord
        Of one unit of length.

    Raises
    ------
    InputError
        Where the folder cannot be written to.
    """
    unit, dim = (records[0].unit, records[0].reading.probe.dim) if records else (LengthUnit(), 2)
    units = {"length": unit.name, "area": f"{unit.name}^2", "1": "1"}
    header = [f"{name} [{units[kind]}]" if kind else name for name, kind in _list_probe_columns(dim)]
    with replaced_on_exit(Path(path)) as temporary:
        _write_csv(temporary, header, chain.from_iterable(map(_list_rows, records)))


def _list_probe_columns(dim: int) -> list[tuple[str, str]]:
    """Names of the columns of a table of probes, and what they are measured in."""
    axes = schema.AXES[:dim]
    return [("time", ""), ("result", ""), ("probe", ""), ("kind", ""),
            ("distance", "length"), *((axis, "length") for axis in axes), ("gauge_length", "length"),
            *((f"u_{axis}", "length") for axis in axes),
            *((f"strain_{component}", "1") for component in schema.list_components(dim)), ("strain_along", "1"),
            ("noise_u", "length"), ("resolution_u", "length"), ("indicator_u", "area"),
            ("noise_strain", "1"), ("resolution_strain", "length"), ("indicator_strain", "area"), ("note", "")]


def _write_csv(path: Path, header: Iterable[str], rows: Iterable[Sequence[str]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(header)
        table.writerows(rows)


def _list_rows(record: ProbeRecord) -> Iterator[list[str]]:
    """A row for each place."""
    reading, probe, size = record.reading, record.reading.probe, record.unit.size
    is_line = isinstance(probe, LineProbe)
    length = math.nan if isinstance(probe, PointProbe | LineProbe) else size * probe.length
    known = record.metrology
    about = [size * known.displacement_noise, size * known.displacement_resolution,
             size**2 * known.displacement_indicator, known.strain_noise, size * known.strain_resolution,
             size**2 * known.strain_indicator]
    note = "; ".join(filter(None, (reading.note, known.note)))
    for k, point in enumerate(reading.points):
        numbers = [size * reading.distance[k] if is_line else math.nan, *(size * point), length,
                   *(size * reading.displacement[k]), *reading.strain[k], reading.along[k], *about]
        yield [format_number(record.time), record.result, probe.name, KINDS[type(probe)],
               *map(format_number, numbers), note]


def format_number(value: float) -> str:
    """Write a number for a table; nothing where it is nan."""
    return "" if math.isnan(value) else f"{value:.{N_DIGITS}g}"


def average_along(values: Array) -> float:
    """Average over the places of a probe at which there is a value; nan where there is none at all."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else math.nan


def write_field_tables(path: Path | str, result: Result) -> tuple[Path, Path]:
    """Write all fields of a result as CSV, with units in the headers: NAME.nodes.csv and NAME.cells.csv.

    Parameters
    ----------
    path : Path or str
        NAME.csv; the two names follow from it.
    result : Result
        What was measured.

    Returns
    -------
    nodes, cells : Path
        The files.

    Raises
    ------
    InputError
        Where the folder cannot be written to.
    """
    nodes, cells = list_field_tables(Path(path))
    mesh = result.mesh
    with replaced_together() as files:
        for target, columns in ((nodes, _list_columns(result, "node", mesh.nodes, result.point_data)),
                                (cells, _list_columns(result, "cell", mesh.centroids, result.cell_data))):
            _write_csv(files.begin(target), columns, zip(*map(_format_column, columns.values()), strict=True))
    return nodes, cells


def write_vtu(path: Path | str, result: Result) -> None:
    """Write a result's mesh and all its fields as a VTU file, for programs that do not read VTKHDF; in pixels.

    Parameters
    ----------
    path : Path or str
        The file.
    result : Result
        What was measured.

    Raises
    ------
    InputError
        Where the folder cannot be written to.
    """
    raw = convert_to_meshio(result.mesh, result.point_data, result.cell_data)
    with replaced_on_exit(Path(path)) as temporary:
        raw.write(temporary, file_format="vtu")
        with temporary.open("a", encoding="ascii") as stream:
            stream.write("<!-- written by ddic export -->\n")


def list_field_tables(path: Path) -> tuple[Path, Path]:
    """Name the tables of nodes and of cells of NAME.csv: NAME.nodes.csv and NAME.cells.csv."""
    nodes, cells = (path.with_name(f"{path.stem}.{what}{path.suffix or '.csv'}") for what in ("nodes", "cells"))
    return nodes, cells


def _list_columns(result: Result, what: str, places: Array,
                  data: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Columns by their header: number, place, then all fields; numbers of nodes and cells are those of the file."""
    numbers = data[schema.GLOBAL_NODE_ID if what == "node" else schema.GLOBAL_CELL_ID]
    length_unit, axes = find_length_unit(result).name, schema.AXES[:result.mesh.dim]
    specs = (*schema.point_fields(length_unit), *schema.nodal_strain_fields(), *schema.cell_fields())
    units = {spec.name: spec.unit for spec in specs}
    columns: dict[str, NDArray[Any]] = {what: numbers}
    columns |= {f"{axis} [px]": places[:, k] for k, axis in enumerate(axes)}
    for name, values in data.items():
        if name in (schema.GLOBAL_NODE_ID, schema.GLOBAL_CELL_ID):
            continue
        unit = units.get(name, "1")
        if values.ndim == 1:
            columns[f"{name} [{unit}]"] = values
        elif values.shape[1] == schema.VECTOR:
            columns |= {f"{name}_{axis} [{unit}]": values[:, k] for k, axis in enumerate(axes)}
        else:
            components = schema.list_components(len(axes))
            columns |= {f"{name}_{component} [{unit}]": values[:, k] for component, k in components.items()}
    return columns


def _format_column(values: NDArray[Any]) -> list[str]:
    """Numbers as texts; nothing where a value is nan."""
    if np.issubdtype(values.dtype, np.integer):
        return [str(value) for value in values.tolist()]
    return ["" if value != value else f"{value:.{N_DIGITS}g}" for value in values.tolist()]  # noqa: PLR0124  nan alone
