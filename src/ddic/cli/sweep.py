"""``ddic sweep``: a cut-off wavelength and an element size, chosen by trying them out."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ddic.cli.failed_start import take_closed_pipes_as_errors
from ddic.cli.failures import abort_quietly, show_failure
from ddic.errors import InputError, is_disk_failure

if TYPE_CHECKING:
    from ddic.parallel.team import Team
    from ddic.results.sweep import Sweep

LOG_WIDTH = 160
"""Characters of a row where nobody watches."""


@click.command()
@click.argument("case_file", metavar="CASE.toml", type=click.Path(path_type=Path))
@click.option("--lengths", default=None, metavar="L,L,...",
              help="Cut-off wavelengths, px; 0 for no regularization.  [default: none and nine about the case's own]")
@click.option("--elements", default=None, metavar="H,H,...",
              help="Sizes of the elements of a structured mesh, px.  [default: five about the case's own]")
@click.option("--output", type=click.Path(path_type=Path, file_okay=False), default=None,
              help="Folder of the table and the figure; by default that of CASE.toml.")
def sweep(case_file: Path, lengths: str | None, elements: str | None, output: Path | None) -> None:
    """Recommend a cut-off wavelength and an element size; alone or under mpirun.

    Each is tried on the pair of the case and on virtual images made from its reference image: the measured field,
    roughened, applied to it, with noise as it was measured. Writes CASE.sweep.csv and CASE.sweep.png.
    """
    # Imported here because MPI, PETSc and numba start with them, which --help does not need.
    from ddic.parallel.team import Team

    team = Team.world()
    take_closed_pipes_as_errors()
    folder = case_file.parent if output is None else output
    try:
        chosen = team.together(lambda: (_parse(lengths, "--lengths"), _parse(elements, "--elements")))
        team.on_root(lambda: _check_outputs(case_file, folder))
        found = _try_all(team, case_file, *chosen)
        lines = team.on_root(lambda: _write(found, folder, case_file.stem))
    except Exception as error:
        code = show_failure(team, error)
        abort_quietly(team, code)
        sys.exit(code)
    if team.is_root:
        _print_table(found)
        click.echo("\n".join(lines))


def _parse(text: str | None, option: str) -> list[float] | None:
    if text is None:
        return None
    try:
        return [float(part) for part in text.split(",")]
    except ValueError as error:
        raise InputError(f"{option} {text}: give numbers with commas between them, 16,32,64 for instance") from error


def _try_all(team: Team, case_file: Path, lengths: list[float] | None, elements: list[float] | None) -> Sweep:
    """Sweep, with a bar where somebody watches; collective."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    from ddic.api.studies import choose_regularization
    from ddic.cli.console import is_on_terminal

    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=Console(stderr=True), transient=True,
                  disable=not (team.is_root and is_on_terminal())) as bar:
        task = bar.add_task("")

        def advance(what: str, count: int) -> None:
            bar.update(task, description=what, total=count)
            bar.advance(task)

        return choose_regularization(case_file, wavelengths=lengths, element_sizes=elements, advance=advance)


def _write(found: Sweep, folder: Path, stem: str) -> list[str]:
    """Write table and figure; returns the lines that say what was found and where it is."""
    from ddic.io.replace_on_exit import made_folder, replaced_together
    from ddic.plots.canvas import save_figure
    from ddic.plots.curves import draw_sweep
    from ddic.results.sweep import collect_by_size, list_failures, write_sweep

    table, figure = _list_outputs(folder, stem)
    best = found.best
    title = f"recommended: {best.candidate.describe()} (error of {best.virtual_error:.2g} px on the virtual images)"
    try:
        with made_folder(folder), replaced_together() as files:
            write_sweep(found, table, files)
            save_figure(draw_sweep(collect_by_size(found), title), figure, files=files)
    except OSError as error:
        if is_disk_failure(error):
            raise
        raise InputError(f"{folder}: cannot be written to ({error.strerror}); choose another --output") from error
    noise = f"noise of an image, from the residual: {found.camera_noise:.2f} grey levels"
    said = [found.describe_recommendation(), "", found.describe_case(), ""]
    return [*list_failures(found), noise, *said, str(table), str(figure)]


def _check_outputs(case_file: Path, folder: Path) -> None:
    """Refuse outputs that would replace an input."""
    from ddic.case.loader import load_case
    from ddic.case.own_outputs import PICTURE, TRIALS, require_own_output

    for path, kind in zip(_list_outputs(folder, case_file.stem), (TRIALS, PICTURE), strict=True):
        require_own_output(path, kind, load_case(case_file).list_inputs())


def _list_outputs(folder: Path, stem: str) -> tuple[Path, Path]:
    """Table and figure of a case file."""
    return folder / f"{stem}.sweep.csv", folder / f"{stem}.sweep.png"


def _print_table(found: Sweep) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from ddic.cli.console import is_on_terminal
    from ddic.results.sweep import COLUMNS, format_rows

    table = Table(box=None, header_style="bold", pad_edge=False)
    for name in COLUMNS:
        table.add_column(escape(name), justify="right")
    for row in format_rows(found):
        table.add_row(*row, style="bold" if row[-1].endswith("<") else "")
    # A batch log has no width: every row stays one line.
    watched = is_on_terminal()
    console = Console(highlight=False) if watched else Console(highlight=False, width=LOG_WIDTH, force_terminal=False)
    console.print(table)
