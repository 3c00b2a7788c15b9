"""``ddic check``: validate a case without solving it."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ddic.cli.failures import failures_as_lines, take_closed_pipes_as_errors, warnings_as_lines
from ddic.errors import InputError

if TYPE_CHECKING:
    from ddic.case.schema import Case

ENDINGS = (".png", ".pdf", ".svg")


@click.command()
@click.argument("case_file", metavar="CASE.toml", type=click.Path(path_type=Path))
@click.option("--plot", "drawing", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE",
              help="Also draw the mesh over the reference image, as .png, .pdf or .svg.")
def check(case_file: Path, drawing: Path | None) -> None:
    """Validate all inputs of a case file without solving.

    Prints what was found; with problems, one line each on standard error and exit code 2.
    """
    # Imported here because they bring numba, meshio and OpenCV, which --help does not need.
    from ddic.case.loader import load_case
    from ddic.case.own_outputs import PICTURE, require_own_output
    from ddic.check.case import check_case_file

    take_closed_pipes_as_errors()
    with failures_as_lines(drawing), warnings_as_lines():
        if drawing is not None:
            _check_drawing(drawing)
            require_own_output(drawing, PICTURE, (case_file,))
        try:
            report = check_case_file(case_file)
        except InputError:
            # A picture of the mesh may say why.
            if drawing is not None:
                _draw_wrong(case_file, drawing)
            raise
        if drawing is not None:
            loaded = load_case(case_file)
            require_own_output(drawing, PICTURE, loaded.list_inputs())
            _draw(loaded.case, drawing)
    for name, value in report.list_lines():
        click.echo(f"{name:<20}{value}")
    if drawing is not None:
        click.echo(f"{'picture':<20}{drawing}")


def _check_drawing(drawing: Path) -> None:
    """Raise InputError where a picture cannot be written under that name."""
    if drawing.suffix.lower() not in ENDINGS:
        raise InputError(f"--plot {drawing}: the name must end in one of {', '.join(ENDINGS)}")
    if not drawing.absolute().parent.is_dir():
        raise InputError(f"--plot {drawing}: its folder does not exist; create it")


def _draw(case: Case, drawing: Path) -> None:
    """Draw the mesh of a case that was found fit."""
    from ddic.case.methods import find_method
    from ddic.io.volume_file import hold_source
    from ddic.plots.canvas import save_figure
    from ddic.plots.maps import read_below
    from ddic.plots.partition import draw_mesh_preview
    from ddic.problem.region_mesh import list_discontinuities

    reference = hold_source(case.imaging.reference, case.dim)
    mesh = find_method(case).build_result_mesh(case, reference.extent)
    figure = draw_mesh_preview(mesh, read_below(mesh, reference), list_discontinuities(case).lines)
    save_figure(figure, drawing)


def _draw_wrong(case_file: Path, drawing: Path) -> None:
    """Draw the mesh of a case that was refused, as far as there are a mesh and an image."""
    from ddic.case.loader import load_case_leniently
    from ddic.case.own_outputs import PICTURE, require_own_output
    from ddic.inputs.mesh_source import build_mesh_anywhere
    from ddic.io.volume_file import hold_source
    from ddic.plots.canvas import save_figure
    from ddic.plots.maps import read_below
    from ddic.plots.partition import draw_mesh_preview

    with suppress(InputError):
        loaded, _ = load_case_leniently(case_file)
        if loaded is not None:
            require_own_output(drawing, PICTURE, loaded.list_inputs())
            mesh = build_mesh_anywhere(loaded.case)
            reference = hold_source(loaded.case.imaging.reference, loaded.case.dim)
            save_figure(draw_mesh_preview(mesh, read_below(mesh, reference)), drawing)
            click.echo(f"{'picture':<20}{drawing}")
