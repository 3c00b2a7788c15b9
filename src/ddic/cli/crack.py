"""``ddic crack``: the tip of a crack and its stress intensity factors.

``ddic opening``: how far the sides of discontinuities have moved apart, as a table.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from ddic.cli.app import frame_option
from ddic.cli.failures import failures_as_lines, warnings_as_lines

if TYPE_CHECKING:
    from ddic.fracture.crack_tip import CrackTip


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
        found = find_crack_tip(result, line, tip=tip, poisson_ratio=poisson_ratio, plane=plane,
                               ring=Ring(inner, outer))
    units = result.attributes.get("units", {})
    for name, value in _lines(found, shear_modulus, float(units.get("pixel_size", 1.0)),
                              str(units.get("length_unit", "px"))):
        click.echo(f"{name:<16}{value}")


def _lines(found: CrackTip, shear_modulus: float | None, pixel_size: float, unit: str) -> list[tuple[str, str]]:
    """Names and values of what is printed."""
    import numpy as np

    x, y = found.position
    lines = [
        ("tip", f"({x:.2f}, {y:.2f}) px, crack at {np.rad2deg(found.angle):.2f} degrees from +x to +y"),
        ("K_I / mu", f"{found.opening_factor:.5g} px^(1/2)"),
        ("K_II / mu", f"{found.sliding_factor:.5g} px^(1/2)"),
        ("T / mu", f"{found.t_stress:.5g}"),
    ]
    if shear_modulus is not None:
        factor = shear_modulus * np.sqrt(pixel_size)
        lines += [("K_I", f"{factor * found.opening_factor:.5g} [mu] {unit}^(1/2)"),
                  ("K_II", f"{factor * found.sliding_factor:.5g} [mu] {unit}^(1/2)"),
                  ("T", f"{shear_modulus * found.t_stress:.5g} [mu]")]
    return [*lines, ("ring", f"{found.n_cells} cells between {found.inner:.0f} and {found.outer:.0f} px of the tip"),
            ("left over", f"{found.rms:.2g} px RMS beside the series")]


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
    with failures_as_lines(target):
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
