"""Pages that are shown one after the other, as GIF or MP4."""

from __future__ import annotations

import subprocess
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from matplotlib import animation
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from ddic.errors import InputError
from ddic.io.plots.page_room import make_room_above
from ddic.io.replace_on_exit import replaced_on_exit

N_GREYS, N_OF_SCALE = 32, 128
"""Colours of a GIF that are kept for texts and images, and for colour bars; the other ones of 256 are found."""

FAR = 16
"""Difference of a colour from those that are kept, of 255, from which on it counts for what is found."""


def require_writer(ending: str) -> None:
    """Refuse a format for which there is no program here.

    Parameters
    ----------
    ending : {"gif", "mp4"}
        The format.

    Raises
    ------
    InputError
        Where it is MP4 and there is no ffmpeg.
    """
    if ending == "mp4" and not animation.writers.is_available("ffmpeg"):
        raise InputError("--format mp4: ffmpeg is not on the path; install it, or leave --format out (GIF)")


def write_animation(path: Path, pages: Iterable[Figure], height: float, fps: float, dpi: int) -> None:
    """Write pages one after the other.

    Parameters
    ----------
    path : Path
        Whose ending tells the format: gif, mp4.
    pages : iterable of Figure
        Of one width, at least one; each is drawn when it is its turn.
    height : float
        Inches, of the highest page; the others grow to it.
    fps : float
        Pages a second.
    dpi : int
        Dots an inch.

    Raises
    ------
    InputError
        Where ffmpeg fails.
    """
    fitted = (_grow_page(page, height) for page in pages)
    with replaced_on_exit(path) as temporary:
        if path.suffix == ".mp4":
            try:
                _write_mp4(temporary, fitted, fps, dpi)
            except (subprocess.CalledProcessError, BrokenPipeError) as error:
                raise InputError(f"{path}: ffmpeg failed ({error}); leave --format out (GIF)") from error
        else:
            _write_gif(temporary, fitted, fps, dpi)


def _write_gif(path: Path, pages: Iterable[Figure], fps: float, dpi: int) -> None:
    first, *others = [_render(page, dpi) for page in pages]
    first.save(path, format="GIF", save_all=True, append_images=others, duration=round(1000 / fps), loop=0)


def _render(page: Figure, dpi: int) -> Image.Image:
    """A page in 256 colours."""
    canvas = FigureCanvasAgg(page)
    page.set_dpi(dpi)
    canvas.draw()
    drawn = Image.fromarray(np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., :3]))
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


def _grow_page(page: Figure, height: float) -> Figure:
    make_room_above(page, height - page.get_size_inches()[1])
    return page
