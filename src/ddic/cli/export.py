"""``ddic export``: whole fields of a result as tables."""

from __future__ import annotations

from pathlib import Path

import click

from ddic.cli.errors_as_lines import errors_as_lines
from ddic.cli.frame_option import add_frame_option
from ddic.cli.warned import warnings_as_lines
from ddic.errors import InputError


@click.command()
@click.argument("file", metavar="RESULT", type=click.Path(path_type=Path))
@add_frame_option
@click.option("--csv", "table", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="NAME.csv for NAME.nodes.csv and NAME.cells.csv; by default named after RESULT (and "
                   "its frame), beside it.")
def export(file: Path, frame: int | None, table: Path | None) -> None:
    """Write all fields of a result as two CSV tables, a row for each node and for each cell, units in the headers."""
    # Imported here because HDF5 is not needed by --help.
    from ddic.case.own_outputs import CELLS, NODES, require_own_output
    from ddic.io.series_reader import read_frame
    from ddic.probes.tables import list_field_tables, write_field_tables

    of_frame = "" if frame is None else f".frame_{frame}"
    target = file.parent / f"{file.stem}{of_frame}.csv" if table is None else table
    with errors_as_lines(target):
        if not target.name:
            raise InputError("--csv: give the name of a table, results.csv for instance")
        for path, kind in zip(list_field_tables(target), (NODES, CELLS), strict=True):
            require_own_output(path, kind, (file,))
        with warnings_as_lines():
            result = read_frame(file, frame)
        written = write_field_tables(target, result)
    for path in written:
        click.echo(path)
