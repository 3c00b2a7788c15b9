"""A mark on pictures of fields that did not converge, so that none is taken for a result."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from ddic.io.plots.page_room import make_room_above
from ddic.io.plots.page_text import POINTS_AN_INCH, format_title
from ddic.io.result_reader import Result

WORDS = "not converged"

FAILURE_COLOUR = "#b00020"
"""Dark red, which has a contrast of 7 to 1 with white: it is read in print without colours too."""

MARK_POINTS = 12.0
"""Size of the mark's type; a larger value takes more of the page."""

MARK_INCHES = 0.24
"""Height of a line of the mark."""

EDGE_INCHES = 0.1
"""Between the mark and the edges of the page."""


def draw_failures(figure: Figure, shown: Sequence[Result]) -> None:
    """Write above all that is on a page that a result did not converge; nothing where all did.

    The page grows by what that takes; what was on it keeps its size.

    Parameters
    ----------
    figure : Figure
        The page.
    shown : sequence of Result
        What it shows; failures of several are told by the names of the files.
    """
    failed = [result for result in shown if not result.converged]
    if not failed:
        return
    text = WORDS if len(shown) == 1 else f"{', '.join(result.path.name for result in failed)}: {WORDS}"
    width, height = figure.get_size_inches()
    lines = format_title(text, width - 2 * EDGE_INCHES, MARK_POINTS)
    room = EDGE_INCHES + MARK_INCHES * (lines.count("\n") + 1)
    make_room_above(figure, room)
    figure.text(0.5, 1.0 - EDGE_INCHES / (height + room), lines, ha="center", va="top", fontsize=MARK_POINTS,
                fontweight="bold", color=FAILURE_COLOUR, linespacing=MARK_INCHES * POINTS_AN_INCH / MARK_POINTS / 1.2)
