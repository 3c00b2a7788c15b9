"""``ddic check``: validate a case without solving it."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ddic.errors import InputError

if TYPE_CHECKING:
    from ddic.problem.check_report import CheckReport


@click.command()
@click.argument("case_file", metavar="CASE.toml", type=click.Path(path_type=Path))
def check(case_file: Path) -> None:
    """Validate all inputs of a case file without solving.

    Prints what was found; with problems, one line each on standard error and exit code 2.
    """
    # Imported here because they bring numba, meshio and OpenCV, which --help does not need.
    from ddic.problem.check_ranks import check_case_file

    try:
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always", UserWarning)
            report = check_case_file(case_file)
    except InputError as error:
        for line in error.problems:
            click.echo(line, err=True)
        sys.exit(error.exit_code)
    for warning in warned:
        click.echo(f"warning: {warning.message}", err=True)
    for name, value in _lines(report):
        click.echo(f"{name:<20}{value}")


def _lines(report: CheckReport) -> list[tuple[str, str]]:
    """Names and values of what is printed."""
    width, height = report.image_size
    kind = "floating point" if report.bits is None else f"{report.bits} bit"
    cells = ", ".join(f"{count} {name}" for name, count in report.cell_counts.items())
    sets = ", ".join(f"{name} ({count} nodes)" for name, count in report.node_sets.items())
    if report.half_amplitudes is not None:
        regularization = report.half_amplitudes.describe()
    else:
        regularization = "weight eta given" if report.n_controlled_dofs else "none"
    cut = [] if report.discontinuities is None else [("discontinuities", report.discontinuities)]
    return [
        ("images", f"{width} x {height} px, {kind}"),
        ("mesh", f"{report.n_nodes} nodes, {report.n_cells} cells ({cells})"),
        ("node sets", sets or "none"),
        *cut,
        ("unknowns", f"{report.n_dofs}, {report.n_controlled_dofs} of them mechanically controlled"),
        ("regularization", regularization),
        ("pixels per element", f"{report.pixels_min} at least, {report.pixels_mean:.1f} on average"),
        ("result", str(report.output)),
        ("verdict", "ready to run"),
    ]
