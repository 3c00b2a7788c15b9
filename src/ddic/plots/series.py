"""What the frames of a series come to, against time; animations of their pages, as GIF or MP4."""

import subprocess
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from matplotlib import animation
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from PIL import Image

from ddic.arrays import Array
from ddic.errors import InputError
from ddic.io.replace_on_exit import replaced_on_exit
from ddic.io.result_schema import AXES
from ddic.io.series_reader import SeriesHistory
from ddic.plots import canvas
from ddic.plots.canvas import PIXELS, LengthUnit

PAGE_INCHES = (7.0, 9.6)
BLUE, *_ = OF_AXES = ("tab:blue", "tab:orange", "tab:green")

MOST_MARKERS = 60
"""Frames up to which markers are large; a larger value makes curves of long series thick."""

SHARE_ABOVE = 1.15
"""Height of panels that begin at 0, relative to their largest value."""


def draw_time_curves(history: SeriesHistory, name: str, unit: LengthUnit = PIXELS) -> Figure:
    """Draw displacement, strain, residual, noise floor and iterations over time; unmeasured frames are marked."""
    figure = Figure(figsize=PAGE_INCHES, layout="tight")
    panels = figure.subplots(5, 1, sharex=True)
    _draw_displacement(panels[0], history, unit)
    _draw_strain(panels[1], history)
    for axes, values, label in zip(panels[2:], (history.residual, unit.size * history.noise_floor, history.iterations),
                                   ("residual\n[grey levels]", f"noise floor\n[{unit.name}]", "iterations"),
                                   strict=True):
        _draw_curve(axes, history, values, BLUE, "")
        axes.set_ylabel(label)
        # From 0, so that rounding of what stays does not look like a change.
        axes.set_ylim(0, SHARE_ABOVE * float(np.nanmax(values, initial=1e-300)))
    for axes in panels:
        _set_up_panel(axes, history)
    figure.align_ylabels(panels)
    panels[4].yaxis.set_major_locator(MaxNLocator(nbins=5, integer=True))
    panels[4].set_xlabel("time")
    if np.all(history.times == np.round(history.times)):
        panels[4].xaxis.set_major_locator(MaxNLocator(nbins=10, integer=True))
    figure.suptitle(_write_title(history, name), fontsize=canvas.TITLE_POINTS)
    return figure


def _set_up_panel(axes: Axes, history: SeriesHistory) -> None:
    """Marks of frames that were not measured, a grid, numbers, and the legend where there are several curves."""
    n_curves = len(axes.get_legend_handles_labels()[1])
    for number, time in enumerate(history.times[~history.is_measured]):
        axes.axvline(time, color=canvas.FAILURE_COLOUR, linestyle="--", linewidth=1.0,
                     label="not measured" if number == 0 else None)
    axes.grid(alpha=0.25)
    canvas.write_powers_of_ten(axes.yaxis)
    if n_curves:
        axes.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.01, 0.5), borderaxespad=0.0)


def _write_title(history: SeriesHistory, name: str) -> str:
    n_frames, n_failed = len(history.times), int((~history.is_measured).sum())
    failed = f", {n_failed} of them not measured" if n_failed else ""
    return canvas.format_title(f"{name}: {n_frames} frames{failed}", PAGE_INCHES[0] - 0.4, canvas.TITLE_POINTS)


def _draw_displacement(axes: Axes, history: SeriesHistory, unit: LengthUnit) -> None:
    """Mean of the components, and between which values they lie."""
    for component, (colour, axis) in enumerate(zip(OF_AXES, AXES[:history.mean.shape[1]], strict=False)):
        low, high = unit.size * history.lowest[:, component], unit.size * history.highest[:, component]
        symbol = f"u_{axis}"
        axes.fill_between(history.times, low, high, color=colour, alpha=0.18, linewidth=0,
                          label=f"${symbol}$, least to largest")
        for edge in (low, high):
            axes.plot(history.times, edge, color=colour, linewidth=0.7)
        _draw_curve(axes, history, unit.size * history.mean[:, component], colour, f"${symbol}$, mean")
    axes.margins(y=0.12)
    axes.set_ylabel(f"displacement\n[{unit.name}]")


def _draw_strain(axes: Axes, history: SeriesHistory) -> None:
    for k, (colour, values) in enumerate(zip(OF_AXES, history.principal_strains.T, strict=False)):
        _draw_curve(axes, history, values, colour, rf"$\varepsilon_{k + 1}$, mean")
    axes.margins(y=0.12)
    axes.set_ylabel("principal strain\n[-]")


def _draw_curve(axes: Axes, history: SeriesHistory, values: Array, colour: str, label: str) -> None:
    """Values of each frame; the curve is broken where one was not measured."""
    size = 3.5 if len(history.times) <= MOST_MARKERS else 1.5
    axes.plot(history.times, values, "o-", markersize=size, color=colour, linewidth=1.4, label=label or None)


N_GREYS, N_OF_SCALE = 32, 128
"""Colours of a GIF that are kept for texts and images, and for colour bars; the other ones of 256 are found."""

FAR = 16
"""Difference of a colour from those that are kept, of 255, from which on it counts for what is found."""


def require_writer(ending: str) -> None:
    """Refuse a format for which there is no program here: raises InputError for ``mp4`` without ffmpeg."""
    if ending == "mp4" and not animation.writers.is_available("ffmpeg"):
        raise InputError("--format mp4: ffmpeg is not on the path; install it, or leave --format out (GIF)")


def write_animation(path: Path, pages: Iterable[Figure], height: float, fps: float, dpi: int) -> None:
    """Write pages of one width, at least one, one after the other, as GIF or MP4 by the ending of the path.

    Each is drawn when it is its turn. ``height`` is that of the highest page, inches; the others grow to it. Raises
    InputError where ffmpeg fails.
    """
    with replaced_on_exit(path) as temporary:
        if path.suffix == ".mp4":
            try:
                _write_mp4(temporary, _grow_pages(pages, height), fps, dpi)
            except (subprocess.CalledProcessError, BrokenPipeError) as error:
                raise InputError(f"{path}: ffmpeg failed ({error}); leave --format out (GIF)") from error
        else:
            first, *others = [_render(page, dpi) for page in _grow_pages(pages, height)]
            first.save(temporary, format="GIF", save_all=True, append_images=others, duration=round(1000 / fps), loop=0)


def _grow_pages(pages: Iterable[Figure], height: float) -> Iterator[Figure]:
    for page in pages:
        canvas.make_room_above(page, height - page.get_size_inches()[1])
        yield page


def _render(page: Figure, dpi: int) -> Image.Image:
    """A page in 256 colours."""
    agg = FigureCanvasAgg(page)
    page.set_dpi(dpi)
    agg.draw()
    drawn = Image.fromarray(np.ascontiguousarray(np.asarray(agg.buffer_rgba())[..., :3]))
    return drawn.quantize(palette=_choose_palette(page, drawn), dither=Image.Dither.FLOYDSTEINBERG)


def _choose_palette(page: Figure, drawn: Image.Image) -> Image.Image:
    """Greys, the colours of the colour bars, of which a frame may show few, and what these do not come near to."""
    maps = {found.get_cmap().name: found.get_cmap() for axes in page.findobj(Axes)
            for found in (*axes.collections, *axes.images) if found.get_array() is not None}
    maps.pop("gray", None)
    places = np.linspace(0, 1, N_OF_SCALE // max(len(maps), 1))
    scales = [255 * colours(places)[:, :3] for colours in maps.values()]
    greys = np.repeat(np.linspace(0, 255, N_GREYS)[:, None], 3, axis=1)
    known = np.concatenate([greys, *scales]).round().astype(np.uint8)
    palette = Image.new("P", (1, 1))
    palette.putpalette(known.ravel().tolist())
    near = np.asarray(drawn.quantize(palette=palette, dither=Image.Dither.NONE).convert("RGB"), np.int16)
    pixels = np.asarray(drawn)
    others = pixels[np.abs(near - pixels).max(axis=2) > FAR]
    if len(others):
        found = Image.fromarray(others[None]).quantize(256 - len(known)).getpalette() or []
        palette.putpalette([*known.ravel().tolist(), *found[:3 * (256 - len(known))]])
    return palette


def _write_mp4(path: Path, pages: Iterable[Figure], fps: float, dpi: int) -> None:
    # Matplotlib says that rates are whole numbers, and passes on any.
    writer = animation.FFMpegWriter(fps=fps, extra_args=["-f", "mp4"])  # type: ignore[arg-type]
    for number, page in enumerate(pages):
        if number == 0:
            writer.setup(page, str(path), dpi)
        # Each page is a figure of its own; the writer takes the one that it was set up with.
        writer.fig = page
        writer.grab_frame()
    writer.finish()
