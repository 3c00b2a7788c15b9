"""The page of a report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from ddic.io import result_schema as schema
from ddic.io.input_file import as_path
from ddic.io.replace_on_exit import replaced_on_exit
from ddic.io.result_reader import Result
from ddic.report.gathered import Gathered, gather_all
from ddic.report.report_pictures import encode_report_figures
from ddic.report.stated_items import find_field_metrology, list_statements
from ddic.report.statement import NOT_RECORDED, NOT_STATED
from ddic.report.worst_places import WorstPlace, find_worst_places

TEMPLATE = "template.html"

PROVENANCE_FIRST = ("date", "command", "reference_path", "reference_sha256", "deformed_path", "deformed_sha256")
"""What stands first in the table of provenance."""


def write_report(result: Result, path: Path | str, image: Path | None = None) -> None:
    """Write one self-contained HTML page on a measurement.

    Parameters
    ----------
    result : Result
        What was measured.
    path : Path or str
        The page.
    image : Path, optional
        Reference image in place of the one that the result names.

    Raises
    ------
    InputError
        Where the folder cannot be written to, or the image is missing.
    """
    path = as_path(path, "report")
    gathered = gather_all(result, image)
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True,
                                     lstrip_blocks=True)
    template = environment.from_string(resources.files("ddic.report").joinpath(TEMPLATE).read_text(encoding="utf-8"))
    places = find_worst_places(result)
    page = template.render(
        title=gathered.case.get("title") or result.path.stem or "measurement", file=result.path.name or "in memory",
        result=result, absent=gathered.absent, key_numbers=_list_key_numbers(gathered),
        statements=list_statements(gathered), not_recorded=NOT_RECORDED, not_stated=NOT_STATED,
        pictures=encode_report_figures(gathered, places), places=[_write_place(place) for place in places],
        phases=_list_phases(gathered), memory=_describe_memory(gathered), notes=list(gathered.summary.get("notes", ())),
        case_path=gathered.get_attribute(schema.CASE, "path") or NOT_RECORDED,
        case_text=str(gathered.get_attribute(schema.CASE, "toml") or ""),
        provenance=_order_provenance(result.attributes.get(schema.PROVENANCE, {})))
    with replaced_on_exit(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def _list_key_numbers(gathered: Gathered) -> list[tuple[str, str]]:
    """What is looked for first."""
    result, known = gathered.result, find_field_metrology(gathered)
    u = result.displacement[result.measured_nodes]
    numbers = [(f"u_{axis}", _write_range(u[:, k], "px", "{:.3f}")) for k, axis in enumerate("xy")]
    tensors = result.point_data.get(schema.NODAL_INFINITESIMAL)
    if tensors is not None:
        numbers += [(f"strain {pair}", _write_range(100.0 * tensors[:, k], "%", "{:.3f}"))
                    for pair, k in (("xx", 0), ("yy", 1), ("xy", 3))]
    return [*numbers, ("residual", _write(gathered.last_residual, "{:.3g} grey levels")),
            ("displacement noise", _write(known.displacement_noise, "{:.2g} px")),
            ("strain noise", _write(known.strain_noise, "{:.1e}")),
            ("strain resolution", _write(known.strain_resolution, "{:.3g} px"))]


def _write_range(values: np.ndarray[Any, Any], unit: str, form: str) -> str:
    if not np.isfinite(values).any():
        return "nothing measured"
    return f"{form.format(np.nanmin(values))} to {form.format(np.nanmax(values))} {unit}"


def _write(value: float, form: str) -> str:
    return form.format(value) if math.isfinite(value) else NOT_RECORDED


def _write_place(place: WorstPlace) -> tuple[str, ...]:
    return (str(place.number), f"({place.x:.0f}, {place.y:.0f})", f"{place.residual_rms:.3g}",
            _write(place.equivalent_error, "{:.3g}"), place.verdict)


def _list_phases(gathered: Gathered) -> list[tuple[str, str, str, float]]:
    """Phases, their wall seconds, CPU seconds and share of the longest in percent; the file's, then the summary's."""
    table, summary = gathered.result.phases, gathered.summary
    if len(table.get("phase", ())):
        names = [name.decode() if isinstance(name, bytes) else str(name) for name in table["phase"]]
        wall = dict(zip(names, map(float, table["seconds"]), strict=True))
        cpu = dict(zip(names, map(float, table["cpu_seconds"]), strict=True))
    else:
        wall, cpu = {}, {}
    # The file cannot hold the time of its own writing.
    wall, cpu = {**wall, **summary.get("seconds", {})}, {**cpu, **summary.get("cpu_seconds", {})}
    longest = max(wall.values(), default=1.0) or 1.0
    rows = [(name, f"{seconds:.2f}", f"{cpu[name]:.2f}" if name in cpu else NOT_RECORDED, 100.0 * seconds / longest)
            for name, seconds in wall.items()]
    total = f"{sum(cpu.values()):.2f}" if set(cpu) >= set(wall) else NOT_RECORDED
    return [*rows, ("sum", f"{sum(wall.values()):.2f}", total, 0.0)] if rows else []


def _describe_memory(gathered: Gathered) -> str:
    peaks: Sequence[int] = gathered.summary.get("peak_memory_bytes", ())
    return ", ".join(f"{peak / 2**20:.0f} MiB" for peak in peaks) or NOT_RECORDED


def _order_provenance(values: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What repeats the measurement, first what identifies it."""
    rest = sorted(set(values) - set(PROVENANCE_FIRST))
    return [(name, str(values[name])) for name in (*PROVENANCE_FIRST, *rest) if name in values]
