"""Texts of a figure that do not fit on its page."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox, BboxBase

ROUNDING_DOTS = 1.0
"""Dots by which a text may reach beyond the page: its box is rounded outwards."""


def find_clipped_texts(figure: Figure) -> list[str]:
    """Find the texts that the edge of the page cuts: titles, labels, numbers at ticks and of legends."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    axes_of_ticks = [axis for axes in figure.findobj(Axes) for axis in (axes.xaxis, axes.yaxis) if axes.axison]
    # Numbers of ticks beyond the limits are made but not drawn: an axis knows which ones are.
    of_ticks = {id(label) for axis in axes_of_ticks for label in axis.get_ticklabels(which="both")}
    boxes: list[tuple[str, Bbox | None]]
    boxes = [(text.get_text(), text.get_window_extent(renderer)) for text in figure.findobj(Text)
             if text.get_visible() and text.get_text().strip() and id(text) not in of_ticks]
    boxes += [(f"axis {axis.get_label_text()}", axis.get_tightbbox(renderer)) for axis in axes_of_ticks]
    return [text for text, box in boxes if box is not None and not _holds(figure.bbox, box)]


def _holds(page: BboxBase, box: BboxBase) -> bool:
    """Whether a box lies on the page."""
    return bool(box.x0 >= page.x0 - ROUNDING_DOTS and box.y0 >= page.y0 - ROUNDING_DOTS
                and box.x1 <= page.x1 + ROUNDING_DOTS and box.y1 <= page.y1 + ROUNDING_DOTS)
