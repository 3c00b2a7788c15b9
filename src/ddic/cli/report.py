"""``ddic report``: one page on a measurement, to hand on."""

from __future__ import annotations

from pathlib import Path

import click

from ddic.cli.app import frame_option
from ddic.cli.failures import failures_as_lines, warnings_as_lines


@click.command()
@click.argument("file", metavar="RESULT", type=click.Path(path_type=Path))
@click.option("--image", type=click.Path(path_type=Path), default=None,
              help="Reference image; by default the one named in the result, if it is still there.")
@frame_option
@click.option("--output", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="Page to write; by default RESULT.report.html beside it.")
def report(file: Path, image: Path | None, frame: int | None, output: Path | None) -> None:
    """Write one self-contained HTML page on a result: fields, residual, convergence, what guides ask to be stated.

    Of a series its last frame is taken where --frame names none.
    """
    # Imported here because matplotlib is not needed by --help.
    from ddic.case.own_outputs import PAGE, require_own_output
    from ddic.io.series_reader import read_frame_or_last
    from ddic.report.page import write_report

    target = file.parent / f"{file.stem}.report.html" if output is None else output
    with failures_as_lines(target), warnings_as_lines():
        require_own_output(target, PAGE, (file, image))
        result, _ = read_frame_or_last(file, frame)
        write_report(result, target, image)
    click.echo(target)

