"""Texts on a page: titles that fit, and which texts do not."""

from __future__ import annotations

import textwrap

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox, BboxBase

POINTS_AN_INCH = 72.0

CHARACTER = 0.62
"""Mean width of a character of a title relative to its size; a larger value breaks lines earlier."""

ROUNDING_DOTS = 1.0
"""Dots by which a text may reach beyond the page: its box is rounded outwards."""


def format_title(text: str, width: float, size: float) -> str:
    """Break a title into lines that fit.

    Parameters
    ----------
    text : str
        Plain, or with TeX that has no blank in it.
    width : float
        Inches.
    size : float
        Of its type, points.

    Returns
    -------
    str
        Lines.
    """
    n_characters = max(8, int(width * POINTS_AN_INCH / (CHARACTER * size)))
    return "\n".join(textwrap.wrap(text, n_characters, break_on_hyphens=False))


def find_clipped_texts(figure: Figure) -> list[str]:
    """Find the texts that the edge of the page cuts: titles, labels, numbers at ticks and of legends.

    Parameters
    ----------
    figure : Figure
        The page.

    Returns
    -------
    list of str
        Those texts.
    """
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
