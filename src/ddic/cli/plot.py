"""``ddic plot``: figures of a result file."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from ddic.cli.warned import warnings_as_lines
from ddic.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ddic.io.plots.preview import Preview
    from ddic.io.result_reader import Result
    from ddic.separated.separated_field import SeparatedField

KINDS = ("partition", "deformed", "residual", "difference", "krylov", "opening", "near-far", "modes", "corrections")


@click.command()
@click.argument("file", metavar="FILE", type=click.Path(path_type=Path))
@click.option("--kind", type=click.Choice([*KINDS, "all"]), default="all", show_default=True,
              help="Figure to draw; all draws what the file allows.")
@click.option("--component", type=click.Choice(["x", "y", "magnitude"]), default="magnitude",
              show_default=True, help="Displacement component in colour.")
@click.option("--amplification", type=float, default=None,
              help="Factor on the displacement of the deformed mesh; chosen if not given.")
@click.option("--other", type=click.Path(path_type=Path), default=None,
              help="Second result: its difference is drawn, and its Krylov curves beside the first one's.")
@click.option("--image", type=click.Path(path_type=Path), default=None,
              help="Reference image; by default the one named in the result, if it is still there.")
@click.option("--output", type=click.Path(path_type=Path, file_okay=False), default=None,
              help="Folder of the pictures; by default that of FILE.")
def plot(file: Path, kind: str, component: Literal["x", "y", "magnitude"], amplification: float | None,
         other: Path | None, image: Path | None, output: Path | None) -> None:
    """Draw a result file as PNG pictures named FILE.KIND.png."""
    # Imported here because matplotlib is not needed by --help.
    from ddic.io.plots.canvas import save_figure
    from ddic.io.result_reader import read_result

    folder = file.parent if output is None else output
    try:
        with warnings_as_lines():
            result = read_result(file)
            second = None if other is None else read_result(other)
        kinds = _kinds(kind, result, second)
        preview = _reference(result, image) if "partition" in kinds else None
        folder.mkdir(parents=True, exist_ok=True)
        for name in kinds:
            figure = _figure(name, result, second, preview, component, amplification)
            target = folder / f"{file.stem}.{name}.png"
            save_figure(figure, target)
            click.echo(target)
    except InputError as error:
        for line in error.problems:
            click.echo(line, err=True)
        sys.exit(error.exit_code)
    except OSError as error:
        click.echo(f"{folder}: cannot be written to ({error.strerror}); choose another --output", err=True)
        sys.exit(InputError.exit_code)


def _kinds(asked: str, result: Result, other: Result | None) -> list[str]:
    """Figures to draw; raises InputError if the one asked for needs what is not there."""
    from ddic.fracture.lines_of_result import get_lines
    from ddic.io.result_schema import CAMERA

    lacking = {}
    if other is None:
        lacking["difference"] = "--kind difference compares two results; give the second by --other"
    if not _has_curves(result):
        lacking["krylov"] = "holds no Krylov history (a direct method); choose another --kind"
    if not get_lines(result):
        lacking["opening"] = "was measured without discontinuities; choose another --kind"
    if CAMERA not in result.cell_data:
        lacking["near-far"] = "is of one camera (a case without [[near]]); choose another --kind"
    if result.separated is None:
        lacking["modes"] = lacking["corrections"] = "was not measured by PGD-DIC ([pgd]); choose another --kind"
    elif not len(result.corrections.get("correction", ())):
        lacking["corrections"] = "took no correction; choose another --kind"
    if asked in lacking:
        raise InputError(f"{result.path}: {lacking[asked]}")
    return [kind for kind in KINDS if kind not in lacking] if asked == "all" else [asked]


def _has_curves(result: Result) -> bool:
    """Whether a result has a Krylov history."""
    return any(len(history) for history in result.krylov)


def _reference(result: Result, image: Path | None) -> Preview | None:
    """The image that is drawn below the partition; None where it is no longer there."""
    from ddic.io.image_file import open_image
    from ddic.io.plots.preview import read_preview

    if image is None:
        image = Path(str(result.attributes.get("provenance", {}).get("reference_path", "")))
        if not image.is_file():
            return None
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always", UserWarning)
        preview = read_preview(open_image(image))
    for warning in warned:
        click.echo(f"warning: {warning.message}", err=True)
    return preview


def _figure(kind: str, result: Result, other: Result | None, preview: Preview | None,
            component: Literal["x", "y", "magnitude"], amplification: float | None) -> Figure:
    """One figure, by its kind; a difference is asked for only where there is another result."""
    from ddic.io.plots.camera_fields import draw_near_far
    from ddic.io.plots.correction_curves import draw_corrections
    from ddic.io.plots.deformed import draw_deformed
    from ddic.io.plots.difference import draw_difference
    from ddic.io.plots.mode_functions import draw_modes
    from ddic.io.plots.partition import draw_partition
    from ddic.io.plots.residual import draw_residual

    by_kind: dict[str, Callable[[], Figure]] = {
        "partition": lambda: draw_partition(result, preview),
        "deformed": lambda: draw_deformed(result, component, amplification),
        "residual": lambda: draw_residual(result),
        "difference": lambda: draw_difference(result, other or result, component),
        "krylov": lambda: _draw_krylov(result, other),
        "opening": lambda: _draw_opening(result),
        "near-far": lambda: draw_near_far(result, component),
        "modes": lambda: draw_modes(_get_separated(result)),
        "corrections": lambda: draw_corrections(result.corrections),
    }
    return by_kind[kind]()


def _get_separated(result: Result) -> SeparatedField:
    """The products of a result that has them: others are not asked for modes."""
    if result.separated is None:
        raise TypeError("a result without products has no modes")
    return result.separated


def _draw_krylov(result: Result, other: Result | None) -> Figure:
    """Convergence of one result or two."""
    from ddic.io.plots.krylov import draw_krylov

    results = [one for one in (result, other) if one is not None and _has_curves(one)]
    return draw_krylov({_label(one, results): one.krylov for one in results})


def _draw_opening(result: Result) -> Figure:
    """Opening of all lines."""
    from ddic.fracture.line_opening import measure_openings
    from ddic.io.plots.opening_curves import draw_opening

    found = measure_openings(result)
    return draw_opening({f"line {number}": (of_line.distance, of_line.tangential, of_line.normal)
                         for number, of_line in enumerate(found, start=1)})


def _label(result: Result, among: list[Result]) -> str:
    """File name, with its folder where two results have the same one."""
    names = [one.path.name for one in among]
    return str(result.path) if names.count(result.path.name) > 1 else result.path.name
