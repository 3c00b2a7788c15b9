"""Numbered marks on a picture."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

PLACE_COLOUR = "#00e5ff"
"""Of marks: seen on the dark and on the bright end of the residual's colours."""


def draw_marks(axes: Axes, places: Sequence[tuple[float, float]], size: float = 1.0) -> None:
    """Draw a circle about each place, with its number.

    Parameters
    ----------
    axes : Axes
        In image coordinates.
    places : sequence of (x, y)
        Pixels, numbered from 1.
    size : float, optional
        Of a pixel, in the axes' unit.
    """
    outline = [withStroke(linewidth=3.0, foreground="black")]
    right = axes.get_xlim()[1]
    for number, (x, y) in enumerate(places, start=1):
        at = (size * x, size * y)
        axes.plot(*at, "o", markersize=13, markerfacecolor="none", markeredgecolor=PLACE_COLOUR, markeredgewidth=1.8,
                  path_effects=outline, clip_on=False)
        # On the left of places near the right edge, so that no number leaves the picture.
        is_right = at[0] > 0.9 * right
        axes.annotate(str(number), at, xytext=(-11 if is_right else 11, 0), textcoords="offset points",
                      color=PLACE_COLOUR, fontsize=11, fontweight="bold", va="center", ha="right" if is_right else "left",
                      path_effects=outline)
