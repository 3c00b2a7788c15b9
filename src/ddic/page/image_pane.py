"""An image in the browser that is zoomed and moved: what is in sight is read, drawn over and sent anew.

The whole of it is never sent.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from bokeh.models import ColumnDataSource, CustomJS, PanTool, Range1d, ResetTool, WheelZoomTool
from bokeh.plotting import figure
from numpy.typing import NDArray

from ddic.arrays import Array
from ddic.images.binned import ArraySource
from ddic.images.source import ImageSource
from ddic.images.window import Window
from ddic.io.volume_file import hold_source

OVERVIEW = 1 << 22
"""Most pixels of the reduced image that is kept; a larger one takes memory, a smaller one reads the file more often."""

BAND = 1 << 24
"""Pixels that are read at a time."""

CONTRAST = (0.5, 99.5)
"""Percentiles of the grey levels that are black and white."""

LOOKED_AT = 1 << 18
"""Pixels of the reduced image that tell them; a larger one takes longer."""

Box = tuple[float, float, float, float]

Rgba = NDArray[np.uint8]
"""(height, width, 4): red, green, blue and opacity."""


@dataclass(frozen=True, eq=False)
class ScreenRaster:
    """A part of the image plane, reduced or enlarged to the screen.

    Attributes
    ----------
    grey : (height, width) uint8 array
        From black to white.
    box : (x0, y0, x1, y1)
        Of its outer edges, pixels of the image; half a pixel beyond the centres of the outermost ones.
    """

    grey: NDArray[np.uint8]
    box: Box

    @property
    def pitch(self) -> tuple[float, float]:
        """Pixels of the image along the sides of one of the raster."""
        x0, y0, x1, y1 = self.box
        height, width = self.grey.shape
        return (x1 - x0) / width, (y1 - y0) / height

    @cached_property
    def centres(self) -> Array:
        """Places of its pixels row by row, (n, 2), pixels of the image."""
        x0, y0, _, _ = self.box
        height, width = self.grey.shape
        along_x, along_y = self.pitch
        x, y = np.meshgrid(x0 + along_x * (np.arange(width) + 0.5), y0 + along_y * (np.arange(height) + 0.5))
        return np.column_stack([x.ravel(), y.ravel()])

    def place(self, points: Array) -> Array:
        """Place points, (n, 2), pixels of the image, in the raster, counted from the centre of its first pixel."""
        return np.asarray((points - self.box[:2]) / self.pitch - 0.5)


class ScreenImage:
    """An image that is looked at through windows of a screen's size; reduced by whole factors, kept or read anew.

    Parameters
    ----------
    source : ImageSource
        The image.
    """

    def __init__(self, source: ImageSource) -> None:
        self.source = source
        n_pixels = source.width * source.height
        self._factor = 2 ** max(math.ceil(math.log2(n_pixels / OVERVIEW) / 2.0), 0)
        overview = _reduce(source, source.extent, self._factor)
        self._overview = ArraySource(source.path, overview)
        finite = overview[np.isfinite(overview)]
        finite = finite[::max(finite.size // LOOKED_AT, 1)]
        low, high = np.percentile(finite, CONTRAST).tolist() if finite.size else (0.0, 0.0)
        # One grey all over lies in the middle.
        self._black, self._white = (low, high) if low < high else (low - 1.0, low + 1.0)

    @classmethod
    def open(cls, path: Path) -> ScreenImage:
        """Open the file of an image; raises InputError where it is none."""
        return cls(hold_source(path, 2))

    @classmethod
    def make_blank(cls, width: int, height: int) -> ScreenImage:
        """Make a grey image, in the place of one that is no longer there."""
        # One row that stands for all.
        grey = np.broadcast_to(np.full(width, 128, np.uint8), (height, width))
        return cls(ArraySource(Path(), grey))

    def read(self, box: Box, width: int, height: int) -> ScreenRaster:
        """Read what of a box, pixels, lies in the image as a raster of about a screen's width and height.

        Of a box beside the image it is a raster of one pixel of it.
        """
        pitch = max((box[2] - box[0]) / width, (box[3] - box[1]) / height, 1e-3)
        factor = 2 ** max(round(math.log2(pitch)), 0)
        window = self._find_window(box, factor)
        grey = self._take(window, factor)
        if pitch < 1.0:
            # Pixels are seen: what is laid over them wants the screen's resolution.
            copies = round(1.0 / pitch)
            grey = grey.repeat(copies, axis=0).repeat(copies, axis=1)
        return ScreenRaster(grey, (window.x0 - 0.5, window.y0 - 0.5, window.x1 - 0.5, window.y1 - 0.5))

    def _find_window(self, box: Box, factor: int) -> Window:
        """The smallest window of whole blocks about a box, within the image; of one that holds none, all of it."""
        sides = []
        for low, high, size in ((box[0], box[2], self.source.width), (box[1], box[3], self.source.height)):
            n_blocks = max(size // factor, 1)
            begin = int(np.clip(math.floor((low + 0.5) / factor), 0, n_blocks - 1))
            end = int(np.clip(math.ceil((high + 0.5) / factor), begin + 1, n_blocks))
            sides.append((begin * factor, min(end * factor, size)))
        (x0, x1), (y0, y1) = sides
        return Window((x0, y0), (x1, y1))

    def _take(self, window: Window, factor: int) -> NDArray[np.uint8]:
        if factor < self._factor:
            reduced = _reduce(self.source, window, factor)
        else:
            lower, upper = np.array(window.lower), np.array(window.upper)
            in_overview = Window.between(lower // self._factor, -(-upper // self._factor))
            reduced = _reduce(self._overview, in_overview, factor // self._factor)
        share = (reduced - self._black) / (self._white - self._black)
        return np.asarray(255.0 * np.clip(np.nan_to_num(share), 0.0, 1.0), np.uint8)


def _reduce(source: ImageSource, window: Window, factor: int) -> NDArray[np.float32]:
    """Means over blocks, read a band at a time; pixels that fill no block are left out."""
    n_rows, n_columns = max(window.height // factor, 1), max(window.width // factor, 1)
    reduced = np.empty((n_rows, n_columns), np.float32)
    rows_a_band = max(BAND // (window.width * factor), 1)
    for first in range(0, n_rows, rows_a_band):
        last = min(first + rows_a_band, n_rows)
        band = window.take_rows(window.y0 + first * factor, min(window.y0 + last * factor, window.y1))
        pixels = source.read(band)[:, :n_columns * factor]
        values = pixels if pixels.dtype in (np.uint8, np.uint16) else pixels.astype(np.float32)
        reduced[first:last] = cv2.resize(values, (n_columns, last - first), interpolation=cv2.INTER_AREA)
    return reduced


LARGEST_SIDE = 760
"""Of what is in sight, pixels of the screen."""

SMALLEST_SIDE = 200
"""Of the figure of a narrow image."""

SETTLED_MS = 120
"""After a zoom or a move that is told: then what is in sight is read, also while it goes on."""

POINTER_MS = 60
"""From one place of the pointer that is told to the next."""

Layer = Callable[[Rgba, ScreenRaster], None]

FOLLOW_POINTER = """
const now = Date.now();
clearTimeout(source.tags[1]);
const tell = () => { source.tags = [Date.now(), 0]; source.data = {x: [cb_obj.x], y: [cb_obj.y]}; };
if (now - (source.tags[0] || 0) > pause) tell();
else source.tags = [source.tags[0], setTimeout(tell, pause)];
"""


class ImagePane:
    """A figure of an image, with layers drawn over it.

    Parameters
    ----------
    image : ScreenImage
        The image.
    layers : sequence of callable
        Draw over the raster in sight, one after the other.
    largest_side : int
        Of the figure, pixels of the screen.
    name : str
        Of the figure in the browser's document.
    """

    def __init__(self, image: ScreenImage, layers: Sequence[Layer] = (), largest_side: int = LARGEST_SIDE,
                 name: str = "image") -> None:
        self.image, self.layers = image, list(layers)
        width, height = image.source.width, image.source.height
        zoom = largest_side / max(width, height)
        self._size = max(round(zoom * width), SMALLEST_SIDE), max(round(zoom * height), SMALLEST_SIDE)
        # Beside an image that is narrower than the figure there is nothing.
        across, down = 0.5 * self._size[0] / zoom, 0.5 * self._size[1] / zoom
        x, y = 0.5 * (width - 1), 0.5 * (height - 1)
        self.raster = image.read((x - across, y - down, x + across, y + down), *self._size)
        wheel = WheelZoomTool(maintain_focus=False)
        self.figure = figure(
            frame_width=self._size[0], frame_height=self._size[1], tools=[PanTool(), wheel, ResetTool()],
            active_scroll=wheel, x_range=Range1d(x - across, x + across), y_range=Range1d(y + down, y - down),
            toolbar_location="above", background_fill_color="#404040", name=name)
        self.figure.grid.visible = False
        self._shown = ColumnDataSource({"image": [], "x": [], "y": [], "dw": [], "dh": []})
        self.figure.image_rgba(image="image", x="x", y="y", dw="dw", dh="dh", source=self._shown, level="image")
        self._pending = False
        self._partners: list[ImagePane] = []
        # Told at every turn of the wheel; the browser's event of a new range comes 0.3 s after the last one.
        for told in (self.figure.x_range, self.figure.y_range):
            for end in ("start", "end"):
                told.on_change(end, lambda attribute, old, new: self._look_soon())

    @property
    def box(self) -> Box:
        """What is in sight: x0, y0, x1, y1, pixels of the image."""
        x, y = self.figure.x_range, self.figure.y_range
        return float(x.start), float(y.end), float(x.end), float(y.start)

    @property
    def pitch(self) -> float:
        """Pixels of the image along a pixel of the screen."""
        return (self.box[2] - self.box[0]) / self._size[0]

    def send_pointer(self, tell: Callable[[float, float], None]) -> None:
        """Tell of the pointer's place in the image, now and then while it moves."""
        source = ColumnDataSource({"x": [], "y": []}, tags=[0, 0])
        source.on_change("data", lambda attribute, old, new: tell(new["x"][0], new["y"][0]))
        self.figure.js_on_event("mousemove", CustomJS(args={"source": source, "pause": POINTER_MS},
                                                      code=FOLLOW_POINTER))

    def share_view(self, other: ImagePane) -> None:
        """Show the same part of the image as another pane, whichever of the two is moved."""
        self.figure.x_range, self.figure.y_range = other.figure.x_range, other.figure.y_range
        self._partners.append(other)
        other._partners.append(self)

    def show_image(self, image: ScreenImage) -> None:
        """Show an image of the same size."""
        if image is not self.image:
            self.image = image
            self.renew()
        else:
            self.draw()

    def _look_soon(self) -> None:
        if not self._pending:
            self._pending = True
            self.figure.document.add_timeout_callback(self._look_together, SETTLED_MS)

    def _look_together(self) -> None:
        for pane in (self, *self._partners):
            pane.renew()

    def renew(self) -> None:
        """Read what is in sight, and draw it."""
        self._pending = False
        self.raster = self.image.read(self.box, *self._size)
        self.draw()

    def draw(self) -> None:
        """Draw the layers over what was read, and send it."""
        rgba = np.asarray(cv2.cvtColor(self.raster.grey, cv2.COLOR_GRAY2RGBA))
        for layer in self.layers:
            layer(rgba, self.raster)
        x0, y0, x1, y1 = self.raster.box
        packed = np.ascontiguousarray(rgba).view(np.uint32)[..., 0]
        self._shown.data = {"image": [packed], "x": [x0], "y": [y0], "dw": [x1 - x0], "dh": [y1 - y0]}
