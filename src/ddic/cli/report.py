"""``ddic report``: one page on a measurement, to hand on."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from ddic.cli.errors_as_lines import errors_as_lines
from ddic.cli.warned import warnings_as_lines
from ddic.errors import InputError

if TYPE_CHECKING:
    from ddic.io.result_reader import Result


@click.command()
@click.argument("file", metavar="RESULT", type=click.Path(path_type=Path))
@click.option("--image", type=click.Path(path_type=Path), default=None,
              help="Reference image; by default the one named in the result, if it is still there.")
@click.option("--frame", type=click.IntRange(1), default=None,
              help="Of a series, counted from 1 among those that were measured; the last one by default.")
@click.option("--output", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="Page to write; by default RESULT.report.html beside it.")
def report(file: Path, image: Path | None, frame: int | None, output: Path | None) -> None:
    """Write one self-contained HTML page on a result: fields, residual, convergence, what guides ask to be stated."""
    # Imported here because matplotlib is not needed by --help.
    from ddic.report.write_report import write_report

    target = file.with_name(f"{file.stem}.report.html") if output is None else output
    with errors_as_lines(target), warnings_as_lines():
        result = _pick_frame(file, frame)
        write_report(result, target, image)
    click.echo(target)


def _pick_frame(file: Path, number: int | None) -> Result:
    """The result of a pair, or of one frame of a series."""
    from ddic.io.series_reader import read_frames, read_series

    n_frames = len(read_series(file))
    if number is not None and number > n_frames:
        raise InputError(f"{file}: --frame {number}: there are {n_frames}; give a number from 1 to {n_frames}")
    if n_frames <= 1:
        return next(read_frames(file))
    return read_series(file)[(number or n_frames) - 1]
