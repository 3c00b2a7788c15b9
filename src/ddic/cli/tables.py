"""``ddic probe``, ``export``, ``opening`` and ``crack``: numbers and tables that are read from results."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from ddic.cli.app import frame_option
from ddic.cli.failures import failures_as_lines, warnings_as_lines
from ddic.errors import InputError

if TYPE_CHECKING:
    from ddic.arrays import Array
    from ddic.fracture.crack_tip import CrackTip
    from ddic.probes.tables import ProbeRecord


@click.command()
@click.argument("files", metavar="RESULT...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--point", "points", multiple=True, metavar="X,Y[,Z]",
              help="Displacement and strain at a point; three numbers a place on a volume, here and below.")
@click.option("--line", "lines", multiple=True, metavar="X0,Y0,X1,Y1[,SPACING]",
              help="The same at places along a line, by default every pixel.")
@click.option("--gauge", "gauges", multiple=True, metavar="X,Y,LENGTH[,ANGLE[,WIDTH]]",
              help="Strain of the plane that fits the displacement best over a square, or a rectangle; ANGLE in "
                   "degrees from x towards y. On a volume X,Y,Z,LENGTH[,DX,DY,DZ[,WIDTH]]: over a cube, or a bar "
                   "along the vector DX,DY,DZ.")
@click.option("--extensometer", "extensometers", multiple=True, metavar="X0,Y0,X1,Y1",
              help="Engineering strain of the distance of two points.")
@click.option("--probes", "file", type=click.Path(path_type=Path),
              help="TOML file of named probes: [point.A], [line.B], [gauge.C], [extensometer.D].")
@click.option("--measure", type=click.Choice(["infinitesimal", "green-lagrange", "hencky"]), default="infinitesimal",
              help="Strain tensor of xx, yy, xy and so on.")
@click.option("--noise", type=click.FloatRange(min=0, min_open=True), metavar="PX",
              help="Standard deviation of a component of the nodes' displacements, of a static pair for instance; by "
                   "default what the results record.")
@click.option("--csv", "table", type=click.Path(path_type=Path, dir_okay=False), help="Table to write.")
def probe(files: tuple[Path, ...], points: tuple[str, ...], lines: tuple[str, ...], gauges: tuple[str, ...],
          extensometers: tuple[str, ...], file: Path | None,
          measure: Literal["infinitesimal", "green-lagrange", "hencky"], noise: float | None,
          table: Path | None) -> None:
    """Read points, lines, strain gauges and extensometers on results, or on the frames of a series, by their times.

    Places are pixels of the reference image. Every option may be given several times. Beside each probe stand its
    spatial resolution, the wavelength of which 90 % are left, and its noise (docs/probes.md).
    """
    # Imported here because HDF5 is not needed by --help.
    from ddic.case.own_outputs import PROBES, require_own_output
    from ddic.io.series_reader import read_frames
    from ddic.probes.probes import load_probes, parse_probe
    from ddic.probes.tables import measure_probes, write_probe_table

    with failures_as_lines(table):
        if table is not None:
            require_own_output(table, PROBES, (*files, file))
        given = {"point": points, "line": lines, "gauge": gauges, "extensometer": extensometers}
        probes = load_probes(file) if file is not None else []
        if not probes and not any(given.values()):
            raise InputError("no probe: give --point, --line, --gauge, --extensometer, or a file by --probes")
        with warnings_as_lines():
            results = chain.from_iterable(map(read_frames, files))
            first = next(results)
            probes = [*(parse_probe(kind, f"{kind} {number}", text, first.mesh.dim) for kind, texts in given.items()
                        for number, text in enumerate(texts, start=1)), *probes]
            records = measure_probes(chain([first], results), probes, measure, noise)
        if len({record.unit for record in records}) > 1:
            raise InputError("the results have several pixel sizes: read those of each apart")
        if table is not None:
            write_probe_table(table, records)
    _show_readings(records)
    if table is not None:
        click.echo(table)


def _show_readings(records: Sequence[ProbeRecord]) -> None:
    """What probes read on the screen; of lines, the mean."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Column, Table

    from ddic.io.result_schema import AXES, list_components
    from ddic.probes.tables import average_along

    unit, dim = records[0].unit, records[0].reading.probe.dim
    first, *others = list_components(dim)
    numbers = (*(f"u_{axis} [{unit.name}]" for axis in AXES[:dim]), f"+- [{unit.name}]", f"strain {first}", *others,
               "along", "+-", f"resolution u, strain [{unit.name}]")
    table = Table("time", "probe", *(Column(name, justify="right") for name in numbers), box=SIMPLE_HEAD)
    notes: dict[str, None] = {}
    for record in records:
        reading, known = record.reading, record.metrology
        displacement = [_write(unit.size * average_along(values), ".5g") for values in reading.displacement.T]
        strain = [_write(average_along(values), ".3e") for values in (*reading.strain.T, reading.along)]
        fine = [_write(unit.size * value, ".3g") for value in (known.displacement_resolution, known.strain_resolution)]
        table.add_row(_write(record.time), reading.probe.name,
                      *displacement, _write(unit.size * known.displacement_noise, ".2g"),
                      *strain, _write(known.strain_noise, ".1e"), ", ".join(fine))
        for note in filter(None, (reading.note, known.note)):
            notes[f"{record.result}: {reading.probe.name}: {note}"] = None
    console = Console(width=None if Console().is_terminal else 200, markup=False)
    console.print(table)
    for note in notes:
        click.echo(note)


def _write(value: float, how: str = "g") -> str:
    """A number, or a dash where there is none."""
    return "-" if value != value else format(value, how)  # noqa: PLR0124  nan alone


@click.command()
@click.argument("file", metavar="RESULT", type=click.Path(path_type=Path))
@frame_option
@click.option("--csv", "table", type=click.Path(path_type=Path, dir_okay=False),
              help="NAME.csv for NAME.nodes.csv and NAME.cells.csv; by default named after RESULT (and its frame), "
                   "beside it.")
@click.option("--vtu", "fields", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE.vtu",
              help="VTU file to write in place of the tables, or beside them where --csv is given: the mesh and all "
                   "fields, for programs that do not read VTKHDF.")
def export(file: Path, frame: int | None, table: Path | None, fields: Path | None) -> None:
    """Write all fields of a result as two CSV tables, a row for each node and for each cell, units in the headers."""
    # Imported here because HDF5 is not needed by --help.
    from ddic.case.own_outputs import CELLS, NODES, VTU, require_own_output
    from ddic.io.series_reader import read_frame
    from ddic.probes.tables import list_field_tables, write_field_tables, write_vtu

    of_frame = "" if frame is None else f".frame_{frame}"
    target = file.parent / f"{file.stem}{of_frame}.csv" if table is None else table
    with failures_as_lines(target):
        if not target.name:
            raise InputError("--csv: give the name of a table, results.csv for instance")
        tables = list_field_tables(target) if fields is None or table is not None else ()
        outputs = [*zip(tables, (NODES, CELLS), strict=False), *([] if fields is None else [(fields, VTU)])]
        for path, kind in outputs:
            require_own_output(path, kind, (file,))
        with warnings_as_lines():
            result = read_frame(file, frame)
        if tables:
            write_field_tables(target, result)
        if fields is not None:
            write_vtu(fields, result)
    for path, _ in outputs:
        click.echo(path)


@click.command()
@click.argument("file", metavar="RESULT", type=click.Path(path_type=Path))
@frame_option
@click.option("--line", type=int, default=1, help="Number of the discontinuity in the case.")
@click.option("--tip", type=float, nargs=2, help="Where the tip may be, px; by default the line's end.")
@click.option("--inner", type=float, help="Radius about the tip within which nothing counts, px.")
@click.option("--outer", type=float, help="Radius about the tip up to which cells count, px.")
@click.option("--poisson-ratio", type=click.FloatRange(0.0, 0.5), default=0.3, help="nu.")
@click.option("--plane", type=click.Choice(["stress", "strain"]), default="stress",
              help="Plane stress or plane strain.")
@click.option("--shear-modulus", type=click.FloatRange(0.0, min_open=True),
              help="mu in any unit of stress: factors are printed in it too, with the pixel size of the case.")
def crack(file: Path, frame: int | None, line: int, tip: tuple[float, float] | None, inner: float | None,
          outer: float | None, poisson_ratio: float, plane: Literal["stress", "strain"],
          shear_modulus: float | None) -> None:
    """Find the tip of a crack on the straight end of its line, K_I, K_II and T, by a fit of Williams' series."""
    # Imported here because HDF5 is not needed by --help.
    from ddic.fracture.crack_tip import Ring, find_crack_tip
    from ddic.io.series_reader import read_frame

    with failures_as_lines():
        with warnings_as_lines():
            result = read_frame(file, frame)
        found = find_crack_tip(result, line, tip=tip, poisson_ratio=poisson_ratio, plane=plane, ring=Ring(inner, outer))
    units = result.attributes.get("units", {})
    for name, value in _list_crack_lines(found, shear_modulus, float(units.get("pixel_size", 1.0)),
                              str(units.get("length_unit", "px"))):
        click.echo(f"{name:<16}{value}")


def _list_crack_lines(found: CrackTip, shear_modulus: float | None, pixel_size: float,
                      unit: str) -> list[tuple[str, str]]:
    """Names and values of what is printed."""
    from ddic.fracture.crack_tip import N_RINGS

    (x, y), scatter, noise = found.position, found.scatter, found.noise
    values = {"K_I": (found.opening_factor, scatter.opening_factor, noise.opening_factor),
              "K_II": (found.sliding_factor, scatter.sliding_factor, noise.sliding_factor),
              "T": (found.t_stress, scatter.t_stress, noise.t_stress)}
    lines = [("tip", f"({x:.2f}, {y:.2f}) px{_describe_spread(scatter.place, noise.place)}, crack at "
                     f"{math.degrees(found.angle):.2f} degrees from +x to +y"),
             ("K_I / mu", _describe_value(values["K_I"], 1.0, " px^(1/2)")),
             ("K_II / mu", _describe_value(values["K_II"], 1.0, " px^(1/2)")),
             ("T / mu", _describe_value(values["T"], 1.0, ""))]
    if shear_modulus is not None:
        factor = shear_modulus * math.sqrt(pixel_size)
        lines += [("K_I", _describe_value(values["K_I"], factor, f" [mu] {unit}^(1/2)")),
                  ("K_II", _describe_value(values["K_II"], factor, f" [mu] {unit}^(1/2)")),
                  ("T", _describe_value(values["T"], shear_modulus, " [mu]"))]
    share = f", {found.covered:.0%} of the ring" if found.covered < WHOLE_RING else ""
    radii = f"between {found.inner:.0f} and {found.outer:.0f} px of the tip"
    lines.append(("ring", f"{found.n_cells} cells {radii}{share}"))
    if found.limit:
        lines.append(("outer radius", f"{found.outer:.0f} px, {found.limit}"))
    rings = f"standard deviation over {found.n_rings} of {N_RINGS} rings, of smaller outer radii"
    return [*lines, ("scatter", rings if found.n_rings > 1 else "not known: no smaller ring finds a tip"),
            ("left over", f"{found.rms:.2g} px RMS beside the series")]


WHOLE_RING = 0.9
"""Share of a ring that cells cover from which on it counts as whole: at its edges they are in it or not."""


def _describe_value(value: tuple[float, float, float], factor: float, unit: str) -> str:
    """A value with its standard deviations over rings and by noise, times a factor."""
    found, scatter, noise = (factor * one for one in value)
    return f"{found:.5g}{unit}{_describe_spread(scatter, noise)}"


def _describe_spread(scatter: float, noise: float) -> str:
    """Standard deviations, of which those that are not known are left out."""
    known = {"scatter": scatter, "noise": noise}
    return "".join(f", {name} {value:.2g}" for name, value in known.items() if not math.isnan(value))


@click.command()
@click.argument("file", metavar="RESULT", type=click.Path(path_type=Path))
@frame_option
@click.option("--output", type=click.Path(path_type=Path, dir_okay=False),
              help="Table to write; by default RESULT.opening.csv beside it, RESULT.frame_N.opening.csv of a frame.")
def opening(file: Path, frame: int | None, output: Path | None) -> None:
    """Write the opening of a result's discontinuities, pixel by pixel along them, as a CSV table.

    A row is a place on a line: number of the line, distance from its first vertex, x, y, tangential and normal opening,
    pixels; and whether the cell of either side is excluded (as the cell field says, 0 for no) or doubtful (1). Openings
    are nan where it is excluded. They are the displacement of the left side less that of the right one; left is -y
    where the line runs along +x. A positive normal opening parts the sides. Where the result holds standard deviations
    (output.uncertainty), columns sigma_tangential_px and sigma_normal_px are those of the openings, and with a
    regularization bias_tangential_px and bias_normal_px its bias in them.
    The figure is drawn by ddic plot --kind opening.
    """
    # Imported here because HDF5 is not needed by --help.
    import numpy as np

    from ddic.case.own_outputs import OPENINGS, require_own_output
    from ddic.fracture.opening import measure_openings
    from ddic.io.replace_on_exit import replaced_on_exit
    from ddic.io.series_reader import read_frame

    of_frame = "" if frame is None else f".frame_{frame}"
    target = file.parent / f"{file.stem}{of_frame}.opening.csv" if output is None else output
    with failures_as_lines(target):
        require_own_output(target, OPENINGS, (file,))
        with warnings_as_lines():
            result = read_frame(file, frame)
        found = measure_openings(result)
        with replaced_on_exit(target) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
            table = csv.writer(stream)
            known = [name for name in OPENING_ERRORS if getattr(found[0], name) is not None]
            table.writerow(["line", "distance_px", "x_px", "y_px", "tangential_px", "normal_px", "excluded",
                            "doubtful", *(f"{name}_px" for name in known)])
            for number, of_line in enumerate(found, start=1):
                columns = (of_line.distance, *of_line.points.T, of_line.tangential, of_line.normal, of_line.excluded,
                           of_line.doubtful, *(getattr(of_line, name) for name in known))
                table.writerows([number, *(f"{value:.6g}" for value in row)] for row in np.column_stack(columns))
    for number, of_line in enumerate(found, start=1):
        click.echo(f"line {number}: {len(of_line.points)} places, normal opening {_describe_range(of_line.normal)}, "
                   f"tangential {_describe_range(of_line.tangential)} px{_count_excluded(of_line.normal)}")
    click.echo(target)


OPENING_ERRORS = ("sigma_tangential", "sigma_normal", "bias_tangential", "bias_normal")
"""What a result may know of the errors of openings, the last columns of their table."""


def _describe_range(values: Array) -> str:
    """Least and largest of some numbers, of which some may be nan."""
    known = [value for value in values.tolist() if math.isfinite(value)]
    return f"{min(known):.3f} to {max(known):.3f}" if known else "none"


def _count_excluded(values: Array) -> str:
    """Say how many openings are nan, where any is."""
    n_excluded = sum(map(math.isnan, values.tolist()))
    return f"; {n_excluded} places beside excluded cells, nan" if n_excluded else ""
