"""Which frame of a series a page shows, above all that is on it."""

from __future__ import annotations

from matplotlib.figure import Figure

from ddic.io.plots.page_room import make_room_above

CAPTION_POINTS = 11.0
"""Size of the caption's type."""

ROOM_INCHES = 0.34
"""Height of the caption with what is around it."""


def format_caption(number: int, time: float) -> str:
    """Write which frame it is.

    Parameters
    ----------
    number : int
        From 1.
    time : float
        Unit chosen by the user.

    Returns
    -------
    str
        A short line.
    """
    return f"frame {number}, time {time:g}"


def draw_caption(figure: Figure, text: str) -> None:
    """Write a line above all that is on a page, which grows by it.

    Parameters
    ----------
    figure : Figure
        The page.
    text : str
        Short enough for one line.
    """
    make_room_above(figure, ROOM_INCHES)
    height = figure.get_size_inches()[1]
    figure.text(0.5, 1.0 - 0.5 * ROOM_INCHES / height, text, ha="center", va="center", fontsize=CAPTION_POINTS,
                fontweight="bold")
