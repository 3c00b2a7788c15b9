"""Room on a page above what is on it already."""

from __future__ import annotations

from matplotlib.figure import Figure


def make_room_above(figure: Figure, room: float) -> None:
    """Let a page grow above what is on it, which keeps its size.

    Parameters
    ----------
    figure : Figure
        The page.
    room : float
        Inches.
    """
    width, height = figure.get_size_inches()
    share = float(height / (height + room))
    layout = figure.get_layout_engine()
    if layout is not None:
        layout.set(rect=(0.0, 0.0, 1.0, share))  # type: ignore[call-arg]  # that of the engines on which axes are packed
        if figure.get_suptitle():
            figure.suptitle(figure.get_suptitle(), y=0.98 * share)
    else:
        for axes in figure.axes:
            x, y, w, h = axes.get_position(original=True).bounds
            axes.set_position((x, y * share, w, h * share))
    figure.set_size_inches(width, height + room)
