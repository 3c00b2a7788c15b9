"""What ``ddic plot`` draws: pictures of a result, curves of a series over time, and animations."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import click
import numpy as np
from matplotlib.figure import Figure

from ddic.case.own_outputs import PICTURE, require_own_output
from ddic.fracture.opening import get_lines, measure_openings
from ddic.io.replace_on_exit import made_folder, replaced_together
from ddic.io.result_reader import Result
from ddic.io.result_schema import CAMERA
from ddic.io.series_reader import SeriesResult, gather_history
from ddic.plots import canvas, maps
from ddic.plots.curves import draw_corrections, draw_krylov, draw_line, draw_modes, draw_opening
from ddic.plots.partition import draw_partition
from ddic.plots.series import draw_time_curves, write_animation

OF_BOTH = ("difference", "krylov")
"""Kinds that show a second result too, where there is one."""


@dataclass(frozen=True)
class PageFiles:
    """Where pages are written.

    Attributes
    ----------
    folder : Path
        Of all of them.
    stem, ending : str
        Beginning of their names, with the number of a frame, and their format.
    dpi : int
        Dots an inch.
    """

    folder: Path
    stem: str
    ending: str
    dpi: int

    def to_path(self, kind: str) -> Path:
        """Name a file by what it shows."""
        return self.folder / f"{self.stem}.{kind}.{self.ending}"


@dataclass(frozen=True)
class Look:
    """How frames are drawn, as the options give it.

    Attributes
    ----------
    component : {"x", "y", "magnitude"}
        Of the displacement.
    strain : StrainChoice
        Of the strain.
    amplification : float or None
        Of the deformed mesh.
    unit : LengthUnit
        Of lengths.
    limits : (float, float) or None
        Of colours; those of all frames where it is None.
    """

    component: canvas.Component
    strain: maps.StrainChoice
    amplification: float | None
    unit: canvas.LengthUnit
    limits: canvas.Limits | None


@dataclass(frozen=True)
class SharedScale:
    """What the frames of an animation have in common.

    Attributes
    ----------
    limits : sequence of (float, float)
        Of the colours of each panel.
    view : SharedView or None
        Of deformed meshes.
    """

    limits: Sequence[canvas.Limits]
    view: maps.SharedView | None


@dataclass(frozen=True)
class Drawing:
    """What is drawn.

    Attributes
    ----------
    result, other : Result
        What is shown, and a second one that it is compared with, or None.
    look : Look
        How.
    preview : Preview or None
        Of the reference image, below it.
    line : four float, or None
        Ends of the line along which a curve is drawn, pixels.
    files : tuple of Path or None
        Those that it all comes from.
    """

    result: Result
    other: Result | None
    look: Look
    preview: maps.Preview | None
    line: tuple[float, float, float, float] | None
    files: tuple[Path | None, ...]


def find_lacking(result: Result, other: Result | None) -> dict[str, str]:
    """Find what cannot be drawn of a result, and of a second one to compare it with: the reason by kind."""
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
    return lacking


def _has_curves(result: Result) -> bool:
    """Whether a result has a Krylov history."""
    return any(len(history) for history in result.krylov)


def plot_pictures(kinds: Sequence[str], drawing: Drawing, pages: PageFiles, caption: str | None) -> None:
    """Write pictures of one result, all or none; the caption is that of a frame of a series."""
    targets = [pages.to_path(kind) for kind in kinds]
    for target in targets:
        require_own_output(target, PICTURE, drawing.files)
    with made_folder(pages.folder), replaced_together() as files:
        for kind, target in zip(kinds, targets, strict=True):
            figure = _draw(kind, drawing)
            others = [drawing.other] if kind in OF_BOTH and drawing.other is not None else []
            canvas.draw_failures(figure, [drawing.result, *others])
            if caption is not None:
                canvas.draw_caption(figure, caption)
            canvas.save_figure(figure, target, pages.dpi, files)
    for target in targets:
        click.echo(target)


def plot_animation(series: SeriesResult, kind: str, drawing: Drawing, pages: PageFiles, fps: float) -> None:
    """Write an animation of one kind; ``drawing`` shows the first frame."""
    target = pages.to_path(kind)
    require_own_output(target, PICTURE, drawing.files)
    scale = find_shared_scale(series, kind, drawing.look)

    def draw_pages() -> Iterator[Figure]:
        """Draw the frames, which are read one by one, a page each with its number and time."""
        for number, time, result in zip(series.numbers, series.times, series, strict=True):
            page = _draw(kind, replace(drawing, result=result), scale)
            canvas.draw_caption(page, canvas.format_caption(int(number), float(time)))
            yield page

    # Titles may take one line in a frame and two in another: the highest page is known once all were laid out.
    height = max(float(page.get_size_inches()[1]) for page in draw_pages())
    with made_folder(pages.folder):
        write_animation(target, draw_pages(), height, fps, pages.dpi)
    click.echo(target)


def plot_curves(series: SeriesResult, units: str | None, pages: PageFiles) -> None:
    """Write a page with curves of a series, of at least one frame, over time.

    ``units`` is ``px`` or ``physical``, as --units gives it. Raises InputError where the unit is not known.
    """
    target = pages.to_path("curves")
    require_own_output(target, PICTURE, (series.path,))
    unit = canvas.find_length_unit(series[0], units)
    figure = draw_time_curves(gather_history(series), series.path.name, unit)
    with made_folder(pages.folder):
        canvas.save_figure(figure, target, pages.dpi)
    click.echo(target)


def find_shared_scale(series: SeriesResult, kind: str, look: Look) -> SharedScale:
    """Find colours and axes that suit all frames of a series, which is read frame by frame.

    ``kind`` is one that can be animated.
    """
    # (n_frames, n_panels, 2)
    found = np.array([_find_limits(result, kind, look) for result in series])
    low, high = found[..., 0].min(axis=0).tolist(), found[..., 1].max(axis=0).tolist()
    limits = list(zip(low, high, strict=True))
    return SharedScale(limits if look.limits is None else [look.limits] * len(limits),
                       maps.find_shared_view(series, look.amplification, look.unit) if kind == "deformed" else None)


def _find_limits(result: Result, kind: str, look: Look) -> Sequence[canvas.Limits]:
    """Where the colours of a frame by itself begin and end, a panel each."""
    if kind == "strain":
        return [canvas.choose_limits(panel.values) for panel in maps.list_strain_panels(result, look.strain)]
    if kind in ("residual", "signed-residual"):
        return [maps.find_residual_limits(result, signed=kind == "signed-residual")]
    return [canvas.choose_limits(look.unit.size * canvas.pick_component(result.displacement, look.component))]


def _draw(kind: str, drawing: Drawing, scale: SharedScale | None = None) -> Figure:
    """One figure, by its kind; a difference is asked for only where there is another result."""
    result, preview, look = drawing.result, drawing.preview, drawing.look
    component, unit = look.component, look.unit
    limits, of_panels, view = look.limits, None, None
    if scale is not None:
        limits, of_panels, view = scale.limits[0], scale.limits, scale.view
    by_kind: dict[str, Callable[[], Figure]] = {
        "partition": lambda: draw_partition(result, preview, unit),
        "deformed": lambda: maps.draw_deformed(result, component, look.amplification, unit, limits, view),
        "displacement": lambda: maps.draw_displacement(result, preview, component, unit, limits),
        "strain": lambda: maps.draw_strain(result, look.strain, unit, limits, of_panels),
        "residual": lambda: maps.draw_residual(result, unit=unit, limits=limits),
        "signed-residual": lambda: maps.draw_residual(result, signed=True, unit=unit, limits=limits),
        "difference": lambda: maps.draw_difference(result, drawing.other or result, component, unit, limits),
        "krylov": lambda: _draw_krylov(result, drawing.other),
        "opening": lambda: _draw_opening(result, unit),
        "near-far": lambda: maps.draw_near_far(result, component, unit),
        "line": lambda: draw_line(result, drawing.line or (0.0, 0.0, 0.0, 0.0), unit),
        "corrections": lambda: draw_corrections(result.corrections),
    }
    if result.separated is not None:
        by_kind["modes"] = partial(draw_modes, result.separated)
    return by_kind[kind]()


def _draw_krylov(result: Result, other: Result | None) -> Figure:
    """Convergence of one result or two, which files' names tell apart, with their folders where these are the same."""
    results = [one for one in (result, other) if one is not None and _has_curves(one)]
    if len(results) == 1:
        return draw_krylov({"": results[0].krylov})
    names = [one.path.name for one in results]
    return draw_krylov({str(one.path) if names.count(name) > 1 else name: one.krylov
                        for name, one in zip(names, results, strict=True)})


def _draw_opening(result: Result, unit: canvas.LengthUnit) -> Figure:
    """Opening of all lines."""
    found = measure_openings(result)
    return draw_opening({f"line {number}": (unit.size * of_line.distance, unit.size * of_line.tangential,
                                            unit.size * of_line.normal)
                         for number, of_line in enumerate(found, start=1)}, unit)


