"""The page of a report, with its pictures in it."""

import base64
import io
import math
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from matplotlib.figure import Figure

from ddic.io import result_schema as schema
from ddic.io.input_file import as_path
from ddic.io.replace_on_exit import replaced_on_exit
from ddic.io.result_reader import Result
from ddic.io.series_reader import gather_history, is_series_file, read_series
from ddic.plots import curves, maps
from ddic.plots.canvas import OF_VALUES, draw_failures, draw_marks, find_length_unit, list_image_axes
from ddic.plots.kinds import COMPONENTS
from ddic.plots.series import draw_time_curves
from ddic.plots.slices import Below, Slices, choose_slices, list_grey_levels
from ddic.report import items

DPI = 110
"""Dots an inch: sharp on a screen, and some hundred kilobytes a picture."""


Drawn = tuple[str, str, Figure]
"""Name, caption and page of a picture."""


def draw_report_figures(gathered: items.Gathered, places: Sequence[items.WorstPlace]) -> dict[str, list[Drawn]]:
    """Draw all pictures that a result allows: name, caption and page of each, by section.

    Sections are series (of a pair empty), fields, residual, convergence and histograms; ``places`` are marked in the
    residual.
    """
    # Of each image, or at the same places of each volume.
    shown = {name: maps.read_below(gathered.result.mesh, image) for name, image in gathered.images.items()}
    reference = shown.get("reference") or maps.read_below(gathered.result.mesh, None)
    drawn = {
        "series": _draw_series(gathered),
        "fields": _draw_fields(gathered, reference),
        "residual": _draw_residual(gathered, places),
        "convergence": _draw_curves(gathered),
        "histograms": _draw_histograms(gathered, shown),
    }
    for of_section in drawn.values():
        for _, _, figure in of_section:
            draw_failures(figure, [gathered.result])
    return drawn


def _draw_series(gathered: items.Gathered) -> list[Drawn]:
    """Curves over time of the series that a result is a frame of."""
    path = gathered.result.path
    if not is_series_file(path):
        return []
    figure = draw_time_curves(gather_history(read_series(path)), path.name, find_length_unit(gathered.result))
    return [("curves", "All frames over time; the other pictures are of one of them.", figure)]


def _draw_fields(gathered: items.Gathered, image: Below) -> list[Drawn]:
    """Displacement and strain over the image, and the deformed mesh; of a volume on slices."""
    result, unit, dim = gathered.result, find_length_unit(gathered.result), gathered.result.mesh.dim
    what = "image" if dim == 2 else "volume"
    over = (f"over the reference {what}" if "reference" in gathered.images else
            f"on the mesh; the reference {what} is not there")
    drawn: list[Drawn] = [(f"displacement {axis}", f"Displacement u_{axis} {over}.",
                           maps.draw_displacement(result, image, axis, unit)) for axis in COMPONENTS[:dim]]
    by_cell = schema.NODAL_INFINITESIMAL not in result.point_data
    where = "in the middle of elements" if by_cell else "at nodes"
    if not by_cell or schema.STRAIN_INFINITESIMAL in result.cell_data:
        # Of six components of a volume those that say most, and what all come to.
        for number in ("xx", "yy", "xy") if dim == 2 else ("xx", "yy", "zz", "von-mises"):
            choice = maps.StrainChoice("infinitesimal", number, by_cell)
            drawn.append((f"strain {number}", f"Infinitesimal strain {number} {where}, {over}.",
                          maps.draw_strain(result, choice, image, unit)))
    if schema.NORMALISED_DIFFERENCE in result.point_data:
        panels = maps.list_simulation_panels(result, "magnitude")
        drawn.append(("simulation", "Measured displacement less the simulated one, levelled, in standard deviations.",
                      maps.draw_values(result.mesh, panels, image, unit, [OF_VALUES])))
    if dim == 3:
        return drawn
    caption = "The deformed mesh without its rigid motion, amplified as the title says, over the mesh at rest."
    return [*drawn, ("deformed mesh", caption, maps.draw_deformed(result, unit=unit))]


def _draw_residual(gathered: items.Gathered, places: Sequence[items.WorstPlace]) -> list[Drawn]:
    """The residual with the worst places; of a volume views through the first of them and slices through the others."""
    what = "by element (no residual image was written)"
    if gathered.result.residual_extent is not None:
        what = "by pixel" if gathered.result.mesh.dim == 2 else "by voxel"
    caption = (f"Correlation residual {what}. Even noise is what a good measurement leaves; the numbered places have "
               "the largest residuals.")
    if gathered.result.mesh.dim == 2:
        return [("residual", caption, _mark_residual(gathered, places, None))]
    centres = [np.rint(place.position).tolist() for place in places]
    first = [list(zip(schema.AXES, centre, strict=True)) for centre in centres[:1]] or [[]]
    drawn = [("residual", caption, _mark_residual(gathered, places, choose_slices(gathered.result.mesh, None, *first)))]
    heights = sorted({z for _, _, z in centres[1:]})
    if heights:
        others = choose_slices(gathered.result.mesh, None, [("z", z) for z in heights])
        drawn.append(("residual elsewhere", "The same across the other numbered places.",
                      _mark_residual(gathered, places, others)))
    return drawn


def _mark_residual(gathered: items.Gathered, places: Sequence[items.WorstPlace], slices: Slices | None) -> Figure:
    """The residual with the worst places that lie in the image, or within half an element of slices of a volume."""
    mesh, unit = gathered.result.mesh, find_length_unit(gathered.result)
    figure = maps.draw_residual(gathered.result, unit=unit, slices=slices)
    half = 0.5 * float(np.prod(np.ptp(mesh.nodes, axis=0)) / mesh.n_cells)**(1.0 / mesh.dim)
    for axes, one in zip(list_image_axes(figure), slices or [None], strict=True):
        near = [place for place in places if one is None or one.measure_distance(place.position) <= half]
        columns = [0, 1] if one is None else one.columns
        draw_marks(axes, {place.number: place.position[columns].tolist() for place in near}, unit.size)
    return figure


def _draw_curves(gathered: items.Gathered) -> list[Drawn]:
    """Convergence of the displacement and of the linear step."""
    result = gathered.result
    drawn: list[Drawn] = []
    if len(result.gauss_newton.get("iteration", ())):
        drawn.append(("iterations", "Corrections of Gauss-Newton, and the residual before each of them.",
                      curves.draw_iterations(result.gauss_newton, gathered.noise_floor)))
    if len(result.corrections.get("correction", ())):
        drawn.append(("corrections", "Corrections of PGD-DIC.", curves.draw_corrections(result.corrections)))
    if any(len(history) for history in result.krylov):
        drawn.append(("Krylov iterations", "Convergence of the interface problem in each iteration.",
                      curves.draw_krylov({"": result.krylov})))
    return drawn


def _draw_histograms(gathered: items.Gathered, shown: Mapping[str, Below]) -> list[Drawn]:
    drawn: list[Drawn] = []
    if gathered.result.residual_extent is not None:
        caption = "The residual beside a normal distribution: what stands above it in the tails is not noise."
        drawn.append(("residual histogram", caption, curves.draw_residual_histogram(gathered.result)))
    if shown:
        where = "images" if gathered.result.mesh.dim == 2 else "volumes in the slices above"
        pixels = {name: list_grey_levels(below) for name, below in shown.items()}
        drawn.append(("grey-level histogram", f"Grey levels of the {where}.", curves.draw_grey_histogram(pixels)))
    return drawn


def _encode(name: str, caption: str, figure: Figure) -> dict[str, str | int]:
    """A figure as a PNG within the page: name, caption, data URI, width and height in dots, as the template asks."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=DPI)
    width, height = (round(DPI * side) for side in figure.get_size_inches())
    data = base64.b64encode(stream.getvalue()).decode("ascii")
    return {"name": name, "caption": caption, "data": f"data:image/png;base64,{data}", "width": width, "height": height}


TEMPLATE = "template.html"

SECONDS = ("seconds", "cpu_seconds")
"""What the result file and the summary call seconds of the wall clock and of the processor."""

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
    gathered = items.gather_all(result, image)
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True,
                                     lstrip_blocks=True)
    template = environment.from_string(resources.files("ddic.report").joinpath(TEMPLATE).read_text(encoding="utf-8"))
    places = items.find_worst_places(result)
    pictures = {section: [_encode(*one) for one in drawn]
                for section, drawn in draw_report_figures(gathered, places).items()}
    peaks: Sequence[int] = gathered.summary.get("peak_memory_bytes", ())
    page = template.render(
        technique=f"digital {'image' if result.mesh.dim == 2 else 'volume'} correlation",
        axes=", ".join(schema.AXES[:result.mesh.dim]),
        title=gathered.case.get("title") or result.path.stem or "measurement", file=result.path.name or "in memory",
        result=result, absent=gathered.absent, key_numbers=_list_key_numbers(gathered),
        statements=items.list_statements(gathered), not_recorded=items.NOT_RECORDED, not_stated=items.NOT_STATED,
        pictures=pictures, places=[_write_place(place) for place in places],
        phases=_list_phases(gathered),
        memory=", ".join(f"{peak / 2**20:.0f} MiB" for peak in peaks) or items.NOT_RECORDED,
        notes=list(gathered.summary.get("notes", ())),
        case_path=gathered.get_attribute(schema.CASE, "path") or items.NOT_RECORDED,
        case_text=str(gathered.get_attribute(schema.CASE, "toml") or ""),
        provenance=_order_provenance(result.attributes.get(schema.PROVENANCE, {})))
    with replaced_on_exit(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def _list_key_numbers(gathered: items.Gathered) -> list[tuple[str, str]]:
    """What is looked for first."""
    result, known = gathered.result, items.find_field_metrology(gathered)
    u, dim = result.displacement[result.measured_nodes], result.mesh.dim
    numbers = [(f"u_{axis}", _write_range(u[:, k], "px", "{:.3f}")) for k, axis in enumerate(schema.AXES[:dim])]
    tensors = result.point_data.get(schema.NODAL_INFINITESIMAL)
    if tensors is not None:
        numbers += [(f"strain {pair}", _write_range(100.0 * tensors[:, k], "%", "{:.3f}"))
                    for pair, k in schema.list_components(dim).items()]
    return [*numbers, ("residual", items.write_number(gathered.last_residual, "{:.3g} grey levels")),
            ("displacement noise", items.write_number(known.displacement_noise, "{:.2g} px")),
            ("strain noise", items.write_number(known.strain_noise, "{:.1e}")),
            ("strain resolution", items.write_number(known.strain_resolution, "{:.3g} px"))]


def _write_range(values: np.ndarray[Any, Any], unit: str, form: str) -> str:
    if not np.isfinite(values).any():
        return "nothing measured"
    return f"{form.format(np.nanmin(values))} to {form.format(np.nanmax(values))} {unit}"


def _write_place(place: items.WorstPlace) -> tuple[str, ...]:
    position = ", ".join(f"{value:.0f}" for value in place.position)
    return (str(place.number), f"({position})", f"{place.residual_rms:.3g}",
            items.write_number(place.equivalent_error, "{:.3g}"), place.verdict)


def _list_phases(gathered: items.Gathered) -> list[tuple[str, str, str, float]]:
    """Phases, their wall seconds, CPU seconds and share of the longest in percent; the file's, then the summary's."""
    table, summary = gathered.result.phases, gathered.summary
    names = [name.decode() if isinstance(name, bytes) else str(name) for name in table.get("phase", ())]
    wall, cpu = (dict(zip(names, map(float, table.get(column, ())), strict=True)) for column in SECONDS)
    # The file cannot hold the time of its own writing.
    wall, cpu = wall | summary.get(SECONDS[0], {}), cpu | summary.get(SECONDS[1], {})
    longest = max(wall.values(), default=1.0) or 1.0
    rows = [(name, f"{seconds:.2f}", items.write_number(cpu.get(name, math.nan), "{:.2f}"), 100.0 * seconds / longest)
            for name, seconds in wall.items()]
    total = items.write_number(sum(cpu.get(name, math.nan) for name in wall), "{:.2f}")
    return [*rows, ("sum", f"{sum(wall.values()):.2f}", total, 0.0)] if rows else []


def _order_provenance(values: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What repeats the measurement, first what identifies it."""
    rest = sorted(set(values) - set(PROVENANCE_FIRST))
    return [(name, str(values[name])) for name in (*PROVENANCE_FIRST, *rest) if name in values]
