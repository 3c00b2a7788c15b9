"""``ddic opening``: how far the sides of discontinuities have moved apart, as a table."""

from __future__ import annotations

import csv
from pathlib import Path

import click

from ddic.cli.errors_as_lines import errors_as_lines
from ddic.cli.frame_option import add_frame_option
from ddic.cli.warned import warnings_as_lines


@click.command()
@click.argument("file", metavar="RESULT", type=click.Path(path_type=Path))
@add_frame_option
@click.option("--output", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="Table to write; by default RESULT.opening.csv beside it, RESULT.frame_N.opening.csv of a frame.")
def opening(file: Path, frame: int | None, output: Path | None) -> None:
    """Write the opening of a result's discontinuities, pixel by pixel along them, as a CSV table.

    A row is a place on a line: number of the line, distance from its first vertex, x, y, tangential and normal opening,
    pixels; and whether the cell of either side is excluded (as the cell field says, 0 for no) or doubtful (1). Openings
    are nan where it is excluded. They are the displacement of the left side less that of the right one; left is -y
    where the line runs along +x. A positive normal opening parts the sides.
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
    with errors_as_lines(target):
        require_own_output(target, OPENINGS, (file,))
        with warnings_as_lines():
            result = read_frame(file, frame)
        found = measure_openings(result)
        with replaced_on_exit(target) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
            table = csv.writer(stream)
            table.writerow(["line", "distance_px", "x_px", "y_px", "tangential_px", "normal_px", "excluded",
                            "doubtful"])
            for number, of_line in enumerate(found, start=1):
                columns = (of_line.distance, *of_line.points.T, of_line.tangential, of_line.normal, of_line.excluded,
                           of_line.doubtful)
                table.writerows([number, *(f"{value:.6g}" for value in row)] for row in np.column_stack(columns))
    for number, of_line in enumerate(found, start=1):
        click.echo(f"line {number}: {len(of_line.points)} places, normal opening {_range(of_line.normal)}, tangential "
                   f"{_range(of_line.tangential)} px{_count_excluded(of_line.normal)}")
    click.echo(target)


def _range(values: object) -> str:
    """Least and largest of some numbers."""
    import numpy as np

    numbers = np.asarray(values)
    numbers = numbers[np.isfinite(numbers)]
    return "none" if not numbers.size else f"{numbers.min():.3f} to {numbers.max():.3f}"


def _count_excluded(values: object) -> str:
    """Say how many openings are nan, where any is."""
    import numpy as np

    n_excluded = int(np.isnan(np.asarray(values)).sum())
    return f"; {n_excluded} places beside excluded cells, nan" if n_excluded else ""
