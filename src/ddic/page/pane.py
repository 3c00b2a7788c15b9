"""An image in the browser that is zoomed and moved: what is in sight is read, painted over and sent anew."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from bokeh.events import RangesUpdate, Reset
from bokeh.io import curdoc
from bokeh.models import ColumnDataSource, CustomJS, PanTool, Range1d, ResetTool, WheelZoomTool
from bokeh.plotting import figure

from ddic.page.layers import Picture, start_picture
from ddic.page.windows import Box, Raster, ScreenImage

LARGEST_SIDE = 760
"""Of what is in sight, pixels of the screen."""

SETTLED_MS = 120
"""After the last zoom or move that is told: then what is in sight is read."""

POINTER_MS = 60
"""From one place of the pointer that is told to the next."""

Layer = Callable[[Picture, Raster], None]

FOLLOW_POINTER = """
const now = Date.now();
clearTimeout(source.tags[1]);
const tell = () => { source.tags = [Date.now(), 0]; source.data = {x: [cb_obj.x], y: [cb_obj.y]}; };
if (now - (source.tags[0] || 0) > pause) tell();
else source.tags = [source.tags[0], setTimeout(tell, pause)];
"""


class ImagePane:
    """A figure of an image, with layers painted over it.

    Parameters
    ----------
    image : ScreenImage
        The image.
    layers : sequence of callable
        Paint over a picture of the raster in sight, one after the other.
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
        self._size = max(round(zoom * width), 200), max(round(zoom * height), 200)
        self.raster = image.read(self._get_box_of_all(), *self._size)
        wheel = WheelZoomTool(maintain_focus=False)
        self.figure = figure(
            frame_width=self._size[0], frame_height=self._size[1], tools=[PanTool(), wheel, ResetTool()],
            active_scroll=wheel, x_range=Range1d(-0.5, width - 0.5), y_range=Range1d(height - 0.5, -0.5),
            toolbar_location="above", background_fill_color="#404040", name=name)
        self.figure.grid.visible = False
        self._shown = ColumnDataSource({"image": [], "x": [], "y": [], "dw": [], "dh": []})
        self.figure.image_rgba(image="image", x="x", y="y", dw="dw", dh="dh", source=self._shown, level="image")
        self._pending = False
        self._partners: list[ImagePane] = []
        self.figure.on_event(RangesUpdate, self._wait_for_rest)
        self.figure.on_event(Reset, self._wait_for_rest)

    def _get_box_of_all(self) -> Box:
        return -0.5, -0.5, self.image.source.width - 0.5, self.image.source.height - 0.5

    @property
    def box(self) -> Box:
        """What is in sight: x0, y0, x1, y1, pixels of the image."""
        x, y = self.figure.x_range, self.figure.y_range
        return float(x.start), float(y.end), float(x.end), float(y.start)

    @property
    def pitch(self) -> float:
        """Pixels of the image along a pixel of the screen."""
        return (self.box[2] - self.box[0]) / self._size[0]

    def follow_pointer(self, tell: Callable[[float, float], None]) -> None:
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
        """Show another image of the same size."""
        self.image = image
        self.look()

    def _wait_for_rest(self, event: object) -> None:
        if not self._pending:
            self._pending = True
            curdoc().add_timeout_callback(self._look_together, SETTLED_MS)

    def _look_together(self) -> None:
        for pane in (self, *self._partners):
            pane.look()

    def look(self) -> None:
        """Read what is in sight, and paint it."""
        self._pending = False
        self.raster = self.image.read(self.box, *self._size)
        self.paint()

    def paint(self) -> None:
        """Paint the layers over what was read, and send it."""
        picture = start_picture(self.raster)
        for paint in self.layers:
            paint(picture, self.raster)
        x0, y0, x1, y1 = self.raster.box
        packed = np.ascontiguousarray(picture).view(np.uint32)[..., 0]
        self._shown.data = {"image": [packed], "x": [x0], "y": [y0], "dw": [x1 - x0], "dh": [y1 - y0]}
