"""Rectangular windows of an image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce


@dataclass(frozen=True)
class Window:
    """Half-open rectangle of pixels: columns x0 <= x < x1, rows y0 <= y < y1.

    Attributes
    ----------
    x0, y0 : int
        First column and row.
    x1, y1 : int
        The column and the row after the last.
    """

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def width(self) -> int:
        """Number of columns."""
        return self.x1 - self.x0

    @property
    def height(self) -> int:
        """Number of rows."""
        return self.y1 - self.y0

    @property
    def n_pixels(self) -> int:
        """Number of pixels."""
        return max(self.width, 0) * max(self.height, 0)

    def grow(self, halo: int) -> Window:
        """Extend on every side by ``halo`` pixels; the result may leave the image."""
        return Window(self.x0 - halo, self.y0 - halo, self.x1 + halo, self.y1 + halo)

    def clip(self, width: int, height: int) -> Window:
        """Intersect with an image; empty where the window lies outside."""
        return self.intersection(Window(0, 0, width, height))

    def intersection(self, other: Window) -> Window:
        """Find the common part of two windows, which may be empty, with x1 <= x0 or y1 <= y0."""
        return Window(max(self.x0, other.x0), max(self.y0, other.y0),
                      min(self.x1, other.x1), min(self.y1, other.y1))

    def union(self, other: Window) -> Window:
        """Find the smallest window that holds two."""
        return Window(min(self.x0, other.x0), min(self.y0, other.y0),
                      max(self.x1, other.x1), max(self.y1, other.y1))

    def locate(self, part: Window) -> tuple[slice, slice]:
        """Find a part of this window in an array of its pixels: slices of rows and columns."""
        return (slice(part.y0 - self.y0, part.y1 - self.y0), slice(part.x0 - self.x0, part.x1 - self.x0))

    def contains(self, other: Window) -> bool:
        """Tell whether another window lies inside."""
        return (self.x0 <= other.x0 and self.y0 <= other.y0
                and self.x1 >= other.x1 and self.y1 >= other.y1)


def merge_windows(windows: Sequence[Window], halo: int) -> list[tuple[Window, list[int]]]:
    """Put neighbours together whose common window holds no more pixels than theirs do, a halo around each.

    Neighbours follow each other in ``windows``. Gives the common windows, without halo, and the numbers of the windows
    in each, in order.
    """
    groups: list[tuple[Window, list[int]]] = []

    def divide(members: list[int]) -> None:
        common = reduce(Window.union, (windows[k] for k in members))
        if common.grow(halo).n_pixels <= sum(windows[k].grow(halo).n_pixels for k in members):
            groups.append((common, members))
            return
        half = len(members) // 2
        divide(members[:half])
        divide(members[half:])

    if windows:
        divide(list(range(len(windows))))
    return groups
