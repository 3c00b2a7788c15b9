"""``ddic probe``: what virtual gauges read on results, as a table.

``ddic export``: whole fields of a result as tables.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from ddic.cli.app import frame_option
from ddic.cli.failures import failures_as_lines, warnings_as_lines
from ddic.errors import InputError

if TYPE_CHECKING:
    from ddic.probes.probes import Probe
    from ddic.probes.tables import ProbeRecord


@click.command()
@click.argument("files", metavar="RESULT...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--point", "points", multiple=True, metavar="X,Y", help="Displacement and strain at a point.")
@click.option("--line", "lines", multiple=True, metavar="X0,Y0,X1,Y1[,SPACING]",
              help="The same at places along a line, by default every pixel.")
@click.option("--gauge", "gauges", multiple=True, metavar="X,Y,LENGTH[,ANGLE[,WIDTH]]",
              help="Strain of the plane that fits the displacement best over a square, or a rectangle; ANGLE in "
                   "degrees from x towards y.")
@click.option("--extensometer", "extensometers", multiple=True, metavar="X0,Y0,X1,Y1",
              help="Engineering strain of the distance of two points.")
@click.option("--probes", "file", type=click.Path(path_type=Path),
              help="TOML file of named probes: [point.A], [line.B], [gauge.C], [extensometer.D].")
@click.option("--measure", type=click.Choice(["infinitesimal", "green-lagrange", "hencky"]), default="infinitesimal",
              help="Strain tensor of xx, yy and xy.")
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
    from ddic.probes.probes import load_probes
    from ddic.probes.tables import measure_probes, write_probe_table

    with failures_as_lines(table):
        if table is not None:
            require_own_output(table, PROBES, (*files, file))
        given = {"point": points, "line": lines, "gauge": gauges, "extensometer": extensometers}
        probes = [*_parse_probes(given), *(load_probes(file) if file is not None else [])]
        if not probes:
            raise InputError("no probe: give --point, --line, --gauge, --extensometer, or a file by --probes")
        with warnings_as_lines():
            results = chain.from_iterable(map(read_frames, files))
            records = measure_probes(results, probes, measure, noise)
        if len({record.unit for record in records}) > 1:
            raise InputError("the results have several pixel sizes: read those of each apart")
        if table is not None:
            write_probe_table(table, records)
    _show(records)
    if table is not None:
        click.echo(table)


def _parse_probes(given: Mapping[str, Sequence[str]]) -> list[Probe]:
    """Probes of the command line, named by their kind and number."""
    from ddic.probes.probes import parse_probe

    return [parse_probe(kind, f"{kind} {number}", text) for kind, texts in given.items()
            for number, text in enumerate(texts, start=1)]


def _show(records: Sequence[ProbeRecord]) -> None:
    """What probes read on the screen; of lines, the mean."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    from ddic.probes.tables import average_along

    unit = records[0].unit
    table = Table(box=SIMPLE_HEAD)
    for name in ("time", "probe"):
        table.add_column(name)
    for name in (f"u_x [{unit.name}]", f"u_y [{unit.name}]", f"+- [{unit.name}]", "strain xx", "yy", "xy", "along",
                 "+-", f"resolution u, strain [{unit.name}]"):
        table.add_column(name, justify="right")
    notes: dict[str, None] = {}
    for record in records:
        reading, known = record.reading, record.metrology
        lengths = [unit.size * value for value in (*map(average_along, reading.displacement.T),
                                                   known.displacement_noise)]
        strains = [*map(average_along, reading.strain.T), average_along(reading.along), known.strain_noise]
        fine = (known.displacement_resolution, known.strain_resolution)
        table.add_row(_write(record.time), reading.probe.name, *(_write(value, ".5g") for value in lengths[:2]),
                      _write(lengths[2], ".2g"), *(_write(value, ".3e") for value in strains[:4]),
                      _write(strains[4], ".1e"), ", ".join(_write(unit.size * value, ".3g") for value in fine))
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
def export(file: Path, frame: int | None, table: Path | None) -> None:
    """Write all fields of a result as two CSV tables, a row for each node and for each cell, units in the headers."""
    # Imported here because HDF5 is not needed by --help.
    from ddic.case.own_outputs import CELLS, NODES, require_own_output
    from ddic.io.series_reader import read_frame
    from ddic.probes.tables import list_field_tables, write_field_tables

    of_frame = "" if frame is None else f".frame_{frame}"
    target = file.parent / f"{file.stem}{of_frame}.csv" if table is None else table
    with failures_as_lines(target):
        if not target.name:
            raise InputError("--csv: give the name of a table, results.csv for instance")
        for path, kind in zip(list_field_tables(target), (NODES, CELLS), strict=True):
            require_own_output(path, kind, (file,))
        with warnings_as_lines():
            result = read_frame(file, frame)
        written = write_field_tables(target, result)
    for path in written:
        click.echo(path)
