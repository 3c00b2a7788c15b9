"""``ddic sweep``: cut-off wavelength, element size by trials; ``ddic uncertainty``: errors of known displacements."""

from __future__ import annotations

import csv
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from ddic.cli.failures import abort_quietly, failures_as_lines, show_failure, take_closed_pipes_as_errors
from ddic.errors import InputError, is_disk_failure

if TYPE_CHECKING:
    from ddic.api.studies import Uncertainty
    from ddic.arrays import Array
    from ddic.parallel.team import Team
    from ddic.results.sweep import Sweep

LOG_WIDTH = 160
"""Characters of a row where nobody watches."""


@click.command()
@click.argument("case_file", metavar="CASE.toml", type=click.Path(path_type=Path))
@click.option("--lengths", metavar="L,L,...",
              help="Cut-off wavelengths, px; 0 for no regularization.  [default: none and nine about the case's own]")
@click.option("--elements", metavar="H,H,...",
              help="Sizes of the elements of a structured mesh, px.  [default: five about the case's own]")
@click.option("--output", type=click.Path(path_type=Path, file_okay=False),
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
    try:
        chosen = team.together(lambda: (_parse_candidates(lengths, "--lengths"),
                                        _parse_candidates(elements, "--elements")))
        table, figure = team.on_root(lambda: _choose_outputs(case_file, output, "sweep"))
        found = _try_all(team, case_file, *chosen)
        lines = team.on_root(lambda: _write_sweep(found, table, figure))
    except Exception as error:
        code = show_failure(team, error)
        abort_quietly(team, code)
        sys.exit(code)
    if team.is_root:
        _print_table(found)
        click.echo("\n".join(lines))


def _parse_candidates(text: str | None, option: str) -> list[float] | None:
    return None if text is None else _parse_numbers(text, option, "16,32,64")


def _parse_numbers(text: str, option: str, example: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError as error:
        raise InputError(f"{option} {text}: give numbers with commas between them, {example} for instance") from error


def _try_all(team: Team, case_file: Path, lengths: list[float] | None, elements: list[float] | None) -> Sweep:
    """Sweep, with a bar where somebody watches; collective."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    from ddic.api.studies import choose_regularization
    from ddic.results.console import is_on_terminal

    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=Console(stderr=True), transient=True,
                  disable=not (team.is_root and is_on_terminal())) as bar:
        task = bar.add_task("")

        def advance(what: str, count: int) -> None:
            bar.update(task, description=what, total=count)
            bar.advance(task)

        return choose_regularization(case_file, cut_off_wavelengths=lengths, element_sizes=elements, advance=advance)


def _write_sweep(found: Sweep, table: Path, figure: Path) -> list[str]:
    """Write table and figure; returns the lines that say what was found and where it is."""
    from ddic.io.replace_on_exit import made_folder, replaced_together
    from ddic.plots.canvas import save_figure
    from ddic.plots.curves import draw_sweep
    from ddic.results.sweep import collect_by_size, list_failures, write_sweep

    best, folder = found.best, table.parent
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


def _choose_outputs(case_file: Path, folder: Path | None, study: Literal["sweep", "uncertainty"]) -> tuple[Path, Path]:
    """Table and figure of a study, by default beside the case; refused where they replace others than its own."""
    from ddic.case.loader import load_case
    from ddic.case.own_outputs import PICTURE, TRIALS, UNCERTAINTY, require_own_output

    beginning = (case_file.parent if folder is None else folder) / f"{case_file.stem}.{study}"
    table, figure = Path(f"{beginning}.csv"), Path(f"{beginning}.png")
    inputs = load_case(case_file).list_inputs()
    require_own_output(table, TRIALS if study == "sweep" else UNCERTAINTY, inputs)
    require_own_output(figure, PICTURE, inputs)
    return table, figure


def _print_table(found: Sweep) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from ddic.results.console import is_on_terminal
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


@click.command()
@click.argument("case_file", metavar="CASE.toml", type=click.Path(path_type=Path))
@click.option("--sizes", default="8,16,32,64", help="Sizes of the elements, px.")
@click.option("--displacements", type=click.IntRange(2), default=11, help="Number of displacements from 0 to 1 px.")
@click.option("--noise", type=click.FloatRange(0.0), default=0.0,
              help="Standard deviation of noise that is added to both images, grey levels.")
@click.option("--output", type=click.Path(path_type=Path, file_okay=False),
              help="Folder of the table and the figure; by default that of CASE.toml.")
def uncertainty(case_file: Path, sizes: str, displacements: int, noise: float, output: Path | None) -> None:
    """Measure known displacements of the case's reference image with continuous and with enriched elements.

    All moves by 0 to 1 px, or the sides of a line slide by as much: the straight line through the ends of the case's
    first discontinuity, or one at 27 degrees. The case's correlation, regularization and gauss_newton hold; masks do
    not. Prints the largest standard deviation over displacements, and writes CASE.uncertainty.csv and
    CASE.uncertainty.png; of a large image its middle is taken.
    """
    # Imported here because they bring numba, PETSc and matplotlib, which --help does not need.
    from ddic.api.studies import BASES, estimate_uncertainty
    from ddic.case.loader import load_case
    from ddic.io.image_file import open_image
    from ddic.io.replace_on_exit import made_folder, replaced_together
    from ddic.plots.canvas import save_figure
    from ddic.plots.curves import draw_uncertainty

    folder = case_file.parent if output is None else output
    with failures_as_lines(folder):
        table, figure = _choose_outputs(case_file, folder, "uncertainty")
        loaded = load_case(case_file)
        loaded.require_images("ddic uncertainty", "set output.uncertainty = true, which tells the errors of a field")
        case = loaded.case
        image = open_image(case.imaging.reference)
        of_elements = _parse_numbers(sizes, "--sizes", "8,16,32")
        said = case.model_dump(include={"correlation", "regularization", "gauss_newton", "discontinuity"}, mode="json")
        sections = {name: values for name, values in said.items() if values}
        grey = image.read(image.extent)
        found = estimate_uncertainty(grey, element_sizes=of_elements, n_amplitudes=displacements, noise=noise,
                                     **sections)
        with made_folder(folder), replaced_together() as files:
            _write_errors(found, BASES, files.begin(table))
            save_figure(draw_uncertainty(found.element_sizes, found.deviation, BASES), figure, files=files)
    take_closed_pipes_as_errors()
    for line_of_table in _list_deviations(found, BASES):
        click.echo(line_of_table)
    click.echo(table)
    click.echo(figure)


def _write_errors(found: Uncertainty, bases: Sequence[str], path: Path) -> None:
    """A row for each kind, element size, displacement and basis."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(["kind", "element_size_px", "displacement_px", "elements", "bias_px", "deviation_px"])
        for kind, deviation in found.deviation.items():
            for s, size in enumerate(found.element_sizes):
                for k, amplitude in enumerate(found.amplitudes):
                    table.writerows([kind, f"{size:g}", f"{amplitude:g}", basis, f"{found.bias[kind][s, k, b]:.4g}",
                                     f"{deviation[s, k, b]:.4g}"] for b, basis in enumerate(bases))


def _list_deviations(found: Uncertainty, bases: Sequence[str]) -> list[str]:
    """Lines of a table: standard deviations, the largest over displacements."""
    lines = ["standard deviation of the displacement [px], the largest over displacements",
             f"{'displacements':<16}{'elements':<12}" + "".join(f"{size:>9g} px" for size in found.element_sizes)]
    # (n_sizes, n_bases) each
    rows: dict[str, Array] = {kind: deviation.max(axis=1) for kind, deviation in found.deviation.items()}
    if found.noise:
        rows["predicted noise"] = found.predicted_noise
    for kind, values in rows.items():
        lines += [f"{kind:<16}{basis:<12}" + "".join(f"{value:12.2e}" for value in column)
                  for basis, column in zip(bases, values.T, strict=True)]
    return lines
