"""The files that ``ddic plot`` writes: pictures of a result, curves of a series over time, and animations."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import click
import numpy as np
from matplotlib.figure import Figure

from ddic.case.own_outputs import PICTURE, require_own_output
from ddic.io.replace_on_exit import made_folder, replaced_together
from ddic.io.series_reader import SeriesResult, gather_history
from ddic.plots import canvas, maps
from ddic.plots.figures import Drawing, Look, SharedScale, draw, find_limits
from ddic.plots.kinds import format_name
from ddic.plots.series import draw_time_curves, write_animation
from ddic.plots.slices import Slices


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
    sources : tuple of Path or None
        What they are drawn from, which none of them replaces.
    """

    folder: Path
    stem: str
    ending: str
    dpi: int
    sources: tuple[Path | None, ...]

    def to_path(self, name: str) -> Path:
        """Name a file by what it shows."""
        target = self.folder / f"{self.stem}.{name}.{self.ending}"
        require_own_output(target, PICTURE, self.sources)
        return target


def _name(kind: str, drawing: Drawing) -> str:
    """What a picture is called."""
    look, choice = drawing.look, drawing.look.strain
    return format_name(kind, look.component, choice.number, choice.measure, drawing.line, look.slices,
                       by_cell=choice.by_cell)


def plot_pictures(kinds: Sequence[str], drawing: Drawing, pages: PageFiles, caption: str | None) -> None:
    """Write pictures of one result, all or none; the caption is that of a frame of a series."""
    targets = [pages.to_path(_name(kind, drawing)) for kind in kinds]
    with made_folder(pages.folder), replaced_together() as files:
        for kind, target in zip(kinds, targets, strict=True):
            figure = draw(kind, drawing)
            if caption is not None and drawing.look.title is None:
                canvas.draw_caption(figure, caption)
            canvas.save_figure(figure, target, pages.dpi, files)
    for target in targets:
        click.echo(target)
    if "difference" in kinds:
        click.echo(f"Err {drawing.compared.err:.3e} (Eq. 41 of [BP17]: |difference| / |second result|, all nodes where "
                   "both were measured)")


def plot_animation(series: SeriesResult, kind: str, drawing: Drawing, pages: PageFiles, fps: float) -> None:
    """Write an animation of one kind; ``drawing`` shows the first frame."""
    target = pages.to_path(_name(kind, drawing))
    shared = find_shared_scale(series, kind, drawing.look, drawing.slices)

    def draw_pages() -> Iterator[Figure]:
        """Draw the frames, which are read one by one, a page each with its number and time."""
        for number, time, result in zip(series.numbers, series.times, series, strict=True):
            page = draw(kind, replace(drawing, result=result), shared)
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
    unit = canvas.find_length_unit(series[0], units)
    figure = draw_time_curves(gather_history(series), series.path.name, unit)
    with made_folder(pages.folder):
        canvas.save_figure(figure, target, pages.dpi)
    click.echo(target)


def find_shared_scale(series: SeriesResult, kind: str, look: Look, slices: Slices | None = None) -> SharedScale:
    """Find colours and axes that suit all frames of a series, read one by one, for a kind that can be animated."""
    # (n_frames, n_panels, 2)
    found = np.array([find_limits(result, kind, look, slices) for result in series])
    low, high = found[..., 0].min(axis=0).tolist(), found[..., 1].max(axis=0).tolist()
    # What the colour bar says of each frame by itself holds for all of them.
    note = look.scale.format_label("").strip()
    scales = [replace(look.scale, limits=limits, note=note) for limits in zip(low, high, strict=True)]
    view = maps.find_shared_view(series, look.amplification, look.unit) if kind == "deformed" else None
    return SharedScale(scales if look.scale.limits is None else [look.scale] * len(scales), view)
