"""``ddic uncertainty``: errors of known displacements of one's own reference image."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ddic.cli.failed_start import take_closed_pipes_as_errors
from ddic.cli.failures import errors_as_lines
from ddic.errors import InputError

if TYPE_CHECKING:
    from ddic.api.studies import Uncertainty


@click.command()
@click.argument("case_file", metavar="CASE.toml", type=click.Path(path_type=Path))
@click.option("--sizes", default="8,16,32,64", show_default=True, help="Sizes of the elements, px.")
@click.option("--displacements", type=click.IntRange(2), default=11, show_default=True,
              help="Number of displacements from 0 to 1 px.")
@click.option("--noise", type=click.FloatRange(0.0), default=0.0, show_default=True,
              help="Standard deviation of noise that is added to both images, grey levels.")
@click.option("--output", type=click.Path(path_type=Path, file_okay=False), default=None,
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
    from ddic.case.own_outputs import PICTURE, UNCERTAINTY, require_own_output
    from ddic.images.window import Window
    from ddic.io.image_file import open_image
    from ddic.io.replace_on_exit import made_folder, replaced_together
    from ddic.plots.canvas import save_figure
    from ddic.plots.curves import draw_uncertainty

    folder = case_file.parent if output is None else output
    table, figure = (folder / f"{case_file.stem}.uncertainty.{ending}" for ending in ("csv", "png"))
    with errors_as_lines(folder):
        loaded = load_case(case_file)
        for path, kind in ((table, UNCERTAINTY), (figure, PICTURE)):
            require_own_output(path, kind, loaded.list_inputs())
        case = loaded.case
        image = open_image(case.images.reference)
        of_elements = _parse_sizes(sizes)
        line = case.discontinuity[0] if case.discontinuity else None
        said = case.model_dump(include={"correlation", "regularization", "gauss_newton"}, mode="json")
        options = {name: values for name, values in said.items() if values}
        section = None if line is None else line.model_dump(mode="json")
        grey = image.read(Window(0, 0, image.width, image.height))
        found = estimate_uncertainty(grey, sizes=of_elements, n_amplitudes=displacements, noise=noise,
                                     options=options, discontinuity=section)
        with made_folder(folder), replaced_together() as files:
            _write(found, files.begin(table))
            save_figure(draw_uncertainty(found.sizes, found.deviation, BASES), figure, files=files)
    take_closed_pipes_as_errors()
    for line_of_table in _list(found):
        click.echo(line_of_table)
    click.echo(table)
    click.echo(figure)


def _parse_sizes(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError as error:
        raise InputError(f"--sizes {text}: give numbers with commas between them, 8,16,32 for instance") from error


def _write(found: Uncertainty, path: Path) -> None:
    """A row for each kind, element size, displacement and basis."""
    from ddic.api.studies import BASES

    with path.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(["kind", "element_size_px", "displacement_px", "elements", "bias_px", "deviation_px"])
        for kind, deviation in found.deviation.items():
            for s, size in enumerate(found.sizes):
                for k, amplitude in enumerate(found.amplitudes):
                    table.writerows([kind, f"{size:g}", f"{amplitude:g}", basis, f"{found.bias[kind][s, k, b]:.4g}",
                                     f"{deviation[s, k, b]:.4g}"] for b, basis in enumerate(BASES))


def _list(found: Uncertainty) -> list[str]:
    """Lines of a table: standard deviations, the largest over displacements."""
    from ddic.api.studies import BASES

    lines = ["standard deviation of the displacement [px], the largest over displacements",
             f"{'displacements':<16}{'elements':<12}" + "".join(f"{size:>9g} px" for size in found.sizes)]
    for kind, deviation in found.deviation.items():
        for b, basis in enumerate(BASES):
            largest = deviation[:, :, b].max(axis=1)
            lines.append(f"{kind:<16}{basis:<12}" + "".join(f"{value:12.2e}" for value in largest))
    if found.noise:
        for b, basis in enumerate(BASES):
            listed = "".join(f"{value:12.2e}" for value in found.predicted_noise[:, b])
            lines.append(f"{'predicted noise':<16}{basis:<12}{listed}")
    return lines
