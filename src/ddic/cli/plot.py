"""``ddic plot``: figures of a result file.

Files of pages that ``ddic plot`` draws: names and formats.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from ddic.cli.app import add_frame_option
from ddic.cli.failures import errors_as_lines, warnings_as_lines
from ddic.cli.plot_series import CURVES, FrameChoice, Look, SharedScale, draw_pages, find_shared_scale, plot_curves
from ddic.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ddic.io.result_reader import Result
    from ddic.io.series_reader import SeriesResult
    from ddic.plots.canvas import LengthUnit
    from ddic.plots.maps import Preview, StrainChoice
    from ddic.separated.field import SeparatedField


FORMATS = ("png", "pdf", "svg")
MOVING = ("gif", "mp4")
"""Formats of animations."""


@dataclass(frozen=True)
class PageFiles:
    """Where pages are written.

    Attributes
    ----------
    folder : Path
        Of all of them.
    stem, ending : str
        Beginning of their names, and their format.
    dpi : int
        Dots an inch.
    """

    folder: Path
    stem: str
    ending: str
    dpi: int

    def to_path(self, *words: str) -> Path:
        """Name a file by what it shows: words between the beginning and the ending."""
        return self.folder / ".".join((self.stem, *words, self.ending))


def choose_ending(asked: str | None, *, animate: bool) -> str:
    """Choose a format: the one asked for, or where that is None the first of FORMATS, of MOVING for an animation.

    Raises InputError where the one that is asked for does not fit, or there is no program for it.
    """
    from ddic.plots.series import require_writer

    fitting = MOVING if animate else FORMATS
    if asked is not None and asked not in fitting:
        what = "an animation is" if animate else "without --animate a picture is"
        raise InputError(f"--format {asked}: {what} one of {', '.join(fitting)}")
    ending = asked or fitting[0]
    require_writer(ending)
    return ending


KINDS = ("partition", "deformed", "displacement", "strain", "residual", "signed-residual", "difference", "krylov",
         "opening", "near-far", "modes", "corrections", "line")
ONLY_ASKED_FOR = ("displacement", "signed-residual", "line")
"""Kinds that show again, in another form or along a line, what others of ``all`` show."""

OF_BOTH = ("difference", "krylov")
OVER_IMAGE = ("partition", "displacement")
WITH_LIMITS = ("deformed", "displacement", "strain", "residual", "signed-residual", "difference")
NUMBERS = ("xx", "yy", "xy", "principal-1", "principal-2", "von-mises")
MEASURES = ("infinitesimal", "green-lagrange", "hencky")


@dataclass(frozen=True)
class _Drawing:
    """What is drawn: a result, what belongs to it, and in which component, unit and colours."""

    result: Result
    other: Result | None
    preview: Preview | None
    component: Literal["x", "y", "magnitude"]
    strain: StrainChoice
    unit: LengthUnit
    limits: tuple[float, float] | None
    amplification: float | None
    line: tuple[float, float, float, float] | None
    files: tuple[Path | None, ...] = ()
    scale: SharedScale | None = None


@click.command()
@click.argument("file", metavar="FILE", type=click.Path(path_type=Path))
@click.option("--kind", type=click.Choice([*KINDS, CURVES, "all"]), default="all", show_default=True,
              help="Figure to draw; all draws what the file allows, but not displacement and signed-residual; of a "
                   "series without --frame and --animate it draws curves over time.")
@add_frame_option
@click.option("--animate", is_flag=True, help="All frames of a series, one after the other, with the same colours.")
@click.option("--fps", type=click.FloatRange(0.1, 100.0), default=5.0, show_default=True,
              help="Frames a second of an animation.")
@click.option("--component", type=click.Choice(["x", "y", "magnitude"]), default="magnitude",
              show_default=True, help="Displacement component in colour.")
@click.option("--strain", "number", type=click.Choice(NUMBERS), default=None,
              help="Strain in colour; by default a panel each of xx, yy and xy.")
@click.option("--measure", type=click.Choice(MEASURES), default="infinitesimal", show_default=True,
              help="Strain tensor that is drawn.")
@click.option("--by-cell", is_flag=True, help="Draw the strain in the middle of cells, not that recovered at nodes.")
@click.option("--limits", type=(float, float), default=None, metavar="LOW HIGH",
              help="Where colours begin and end, in the unit of the colour bar.")
@click.option("--amplification", type=float, default=None,
              help="Factor on the whole displacement of the deformed mesh; by default rigid motion is taken out, and "
                   "what is left is amplified as far as no cell folds.")
@click.option("--line", type=(float, float, float, float), default=None, metavar="X1 Y1 X2 Y2",
              help="Ends of the line of --kind line, pixels of the reference image.")
@click.option("--units", type=click.Choice(["px", "physical"]), default=None,
              help="Of lengths; by default physical where the case gives images.pixel_size.")
@click.option("--other", type=click.Path(path_type=Path), default=None,
              help="Second result: its difference is drawn, and its Krylov curves beside the first one's.")
@click.option("--image", type=click.Path(path_type=Path), default=None,
              help="Reference image; by default the one named in the result, if it is still there.")
@click.option("--format", "ending", type=click.Choice([*FORMATS, *MOVING]), default=None,
              help="Of the pictures, png by default, or of an animation, gif by default; mp4 needs ffmpeg.")
@click.option("--dpi", type=click.IntRange(20, 2400), default=150, show_default=True,
              help="Dots an inch; in PDF and SVG of images and colours alone.")
@click.option("--output", type=click.Path(path_type=Path, file_okay=False), default=None,
              help="Folder of the pictures; by default that of FILE.")
def plot(file: Path, kind: str, frame: int | None, animate: bool, fps: float,
         component: Literal["x", "y", "magnitude"], number: str | None,
         measure: Literal["infinitesimal", "green-lagrange", "hencky"], by_cell: bool,
         limits: tuple[float, float] | None, amplification: float | None,
         line: tuple[float, float, float, float] | None, units: str | None, other: Path | None, image: Path | None,
         ending: str | None, dpi: int, output: Path | None) -> None:
    """Draw a result file as pictures named FILE.KIND.png, for papers as PDF or SVG.

    Of a series: curves over time, a frame by its number (FILE.frame_N.KIND.png), or an animation (FILE.KIND.gif).
    """
    # Imported here because matplotlib is not needed by --help.
    from ddic.io.replace_on_exit import made_folder
    from ddic.io.series_reader import is_series_file, read_frame, read_series
    from ddic.plots.canvas import find_length_unit
    from ddic.plots.maps import StrainChoice

    folder = file.parent if output is None else output
    with errors_as_lines(folder):
        _check_limits(kind, limits)
        if (kind == "line") != (line is not None):
            raise InputError("--line X1 Y1 X2 Y2 goes with --kind line: give both, or neither")
        pages = PageFiles(folder, file.stem, choose_ending(ending, animate=animate), dpi)
        is_series = is_series_file(file)
        FrameChoice(frame, animate, kind).require_drawable(file, is_series=is_series)
        if is_series and frame is None and not animate:
            plot_curves(read_series(file), units, pages)
            return
        series = read_series(file) if animate else None
        with warnings_as_lines():
            result = read_frame(file, frame) if series is None else series[0]
            second = None if other is None else _read_other(other, frame)
        kinds = _kinds(kind, result, second)
        preview = _reference(result, image) if set(kinds) & set(OVER_IMAGE) else None
        drawing = _Drawing(result, second, preview, component, StrainChoice(measure, number, by_cell),
                           find_length_unit(result, units), limits, amplification, line, (file, other, image))
        with made_folder(folder):
            if series is not None:
                _animate(series, kind, drawing, pages, fps)
            else:
                _plot_one(kinds, drawing, pages, _caption(file, frame))


def _read_other(path: Path, frame: int | None) -> Result:
    """The result that is compared with: of a series the same frame."""
    from ddic.io.series_reader import is_series_file, read_frame

    return read_frame(path, frame if is_series_file(path) else None)


def _caption(file: Path, frame: int | None) -> tuple[list[str], str]:
    """What names and pages of a frame hold beside those of a pair."""
    from ddic.io.series_reader import read_series
    from ddic.plots.canvas import format_caption

    if frame is None:
        return [], ""
    times = {record["number"]: float(record["time"]) for record in read_series(file).records}
    return [f"frame_{frame}"], format_caption(frame, times[frame])


def _plot_one(kinds: list[str], drawing: _Drawing, pages: PageFiles, caption: tuple[list[str], str]) -> None:
    """Pictures of one result."""
    from ddic.case.own_outputs import PICTURE, require_own_output
    from ddic.io.replace_on_exit import replaced_together
    from ddic.plots.canvas import draw_caption, draw_failures, save_figure

    words, line = caption
    targets = [pages.to_path(*words, name) for name in kinds]
    for target in targets:
        require_own_output(target, PICTURE, drawing.files)
    with replaced_together() as files:
        for name, target in zip(kinds, targets, strict=True):
            figure = _figure(name, drawing)
            draw_failures(figure, _list_shown(name, drawing))
            if line:
                draw_caption(figure, line)
            save_figure(figure, target, pages.dpi, files)
    for target in targets:
        click.echo(target)


def _animate(series: SeriesResult, kind: str, drawing: _Drawing, pages: PageFiles, fps: float) -> None:
    """An animation of one kind."""
    from ddic.case.own_outputs import PICTURE, require_own_output
    from ddic.plots.series import write_animation

    target = pages.to_path(kind)
    require_own_output(target, PICTURE, drawing.files)
    look = Look(drawing.component, drawing.strain, drawing.amplification, drawing.unit, drawing.limits)
    shared = replace(drawing, scale=find_shared_scale(series, kind, look))

    def draw(result: Result) -> Figure:
        return _figure(kind, replace(shared, result=result))

    # Titles may take one line in a frame and two in another: the highest page is known once all were laid out.
    height = max(float(one.get_size_inches()[1]) for one in draw_pages(series, draw))
    write_animation(target, draw_pages(series, draw), height, fps, pages.dpi)
    click.echo(target)


def _check_limits(kind: str, limits: tuple[float, float] | None) -> None:
    """Raise InputError where limits are no interval, or would be those of several colour bars or of none."""
    if limits is None:
        return
    low, high = limits
    if not low < high:
        raise InputError(f"--limits {low:g} {high:g}: the first must be the smaller one")
    if kind not in WITH_LIMITS:
        raise InputError(f"--limits: for one kind with colours alone ({', '.join(WITH_LIMITS)}), not --kind {kind}")


def _kinds(asked: str, result: Result, other: Result | None) -> list[str]:
    """Figures to draw; raises InputError if the one asked for needs what is not there."""
    from ddic.fracture.opening import get_lines
    from ddic.io.result_schema import CAMERA, NODAL_INFINITESIMAL

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
    if asked != "all":
        return [asked]
    left_out = {*lacking, *ONLY_ASKED_FOR}
    if NODAL_INFINITESIMAL not in result.point_data:
        left_out.add("strain")
    return [kind for kind in KINDS if kind not in left_out]


def _has_curves(result: Result) -> bool:
    """Whether a result has a Krylov history."""
    return any(len(history) for history in result.krylov)


def _reference(result: Result, image: Path | None) -> Preview | None:
    """The image that is drawn below; None where it is no longer there."""
    from ddic.io.image_file import open_image
    from ddic.plots.maps import read_preview

    if image is None:
        named = str(result.attributes.get("provenance", {}).get("reference_path", ""))
        image = Path(named)
        if not image.is_file():
            if named:
                click.echo(f"warning: {named} is no longer there and not drawn; give the image by --image", err=True)
            return None
    with warnings_as_lines():
        return read_preview(open_image(image))


def _figure(kind: str, drawing: _Drawing) -> Figure:
    """One figure, by its kind; a difference is asked for only where there is another result."""
    from ddic.plots.curves import draw_corrections, draw_line, draw_modes
    from ddic.plots.maps import draw_deformed, draw_difference, draw_displacement, draw_near_far, draw_strain
    from ddic.plots.partition import draw_partition
    from ddic.plots.residual import draw_residual

    result, preview, component = drawing.result, drawing.preview, drawing.component
    unit, scale = drawing.unit, drawing.scale
    limits, of_panels, view = drawing.limits, None, None
    if scale is not None:
        limits, of_panels, view = scale.limits[0], scale.limits, scale.view
    by_kind: dict[str, Callable[[], Figure]] = {
        "partition": lambda: draw_partition(result, preview, unit),
        "deformed": lambda: draw_deformed(result, component, drawing.amplification, unit, limits, view),
        "displacement": lambda: draw_displacement(result, preview, component, unit, limits),
        "strain": lambda: draw_strain(result, drawing.strain, unit, limits, of_panels),
        "residual": lambda: draw_residual(result, unit=unit, limits=limits),
        "signed-residual": lambda: draw_residual(result, signed=True, unit=unit, limits=limits),
        "difference": lambda: draw_difference(result, drawing.other or result, component, unit, limits),
        "krylov": lambda: _draw_krylov(result, drawing.other),
        "opening": lambda: _draw_opening(result, unit),
        "near-far": lambda: draw_near_far(result, component, unit),
        "modes": lambda: draw_modes(_get_separated(result)),
        "line": lambda: draw_line(result, drawing.line or (0.0, 0.0, 0.0, 0.0), unit),
        "corrections": lambda: draw_corrections(result.corrections),
    }
    return by_kind[kind]()


def _list_shown(kind: str, drawing: _Drawing) -> list[Result]:
    """The results that a figure shows."""
    if kind not in OF_BOTH or drawing.other is None:
        return [drawing.result]
    return [drawing.result, drawing.other]


def _get_separated(result: Result) -> SeparatedField:
    """The products of a result that has them: others are not asked for modes."""
    if result.separated is None:
        raise TypeError("a result without products has no modes")
    return result.separated


def _draw_krylov(result: Result, other: Result | None) -> Figure:
    """Convergence of one result or two."""
    from ddic.plots.curves import draw_krylov

    results = [one for one in (result, other) if one is not None and _has_curves(one)]
    return draw_krylov({_label(one, results): one.krylov for one in results})


def _draw_opening(result: Result, unit: LengthUnit) -> Figure:
    """Opening of all lines."""
    from ddic.fracture.opening import measure_openings
    from ddic.plots.curves import draw_opening

    found = measure_openings(result)
    return draw_opening({f"line {number}": (unit.size * of_line.distance, unit.size * of_line.tangential,
                                            unit.size * of_line.normal)
                         for number, of_line in enumerate(found, start=1)}, unit)


def _label(result: Result, among: list[Result]) -> str:
    """File name, with its folder where two results have the same one; none where it is the only result."""
    names = [one.path.name for one in among]
    if len(among) == 1:
        return ""
    return str(result.path) if names.count(result.path.name) > 1 else result.path.name
