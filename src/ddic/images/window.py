"""Boxes of pixels, and how neighbours among them are joined."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from math import prod
from operator import ge, le, sub

import numpy as np
from numpy.typing import ArrayLike

from ddic.arrays import Array, IntArray


@dataclass(frozen=True, slots=True)
class Window:
    """Half-open box of pixels, lower <= x < upper along every axis: columns and rows of an image, in this order.

    Arrays of its pixels have their axes the other way round, rows before columns.

    Attributes
    ----------
    lower, upper : tuple of int
        First pixel along each axis, and the one after the last.
    """

    lower: tuple[int, ...]
    upper: tuple[int, ...]

    @classmethod
    def of_size(cls, *sizes: int) -> Window:
        """Give the box of a whole image: its width and height, from the first pixel on."""
        return cls((0,) * len(sizes), sizes)

    @classmethod
    def between(cls, lower: ArrayLike, upper: ArrayLike) -> Window:
        """Give the box between two corners, (dim,) each, in any type of number; the upper one is not in it."""
        first, last = np.asarray(lower).astype(np.int64), np.asarray(upper).astype(np.int64)
        return cls(tuple(first.tolist()), tuple(last.tolist()))

    @property
    def x0(self) -> int:
        """First column."""
        return self.lower[0]

    @property
    def y0(self) -> int:
        """First row of a plane box, as all below that names rows; a volume has planes of them: ValueError."""
        _, first = self.lower
        return first

    @property
    def x1(self) -> int:
        """The column after the last."""
        return self.upper[0]

    @property
    def y1(self) -> int:
        """The row after the last."""
        _, last = self.upper
        return last

    @property
    def sizes(self) -> tuple[int, ...]:
        """Number of pixels along each axis."""
        return tuple(map(sub, self.upper, self.lower))

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of an array of its pixels."""
        return self.sizes[::-1]

    @property
    def width(self) -> int:
        """Number of columns."""
        return self.x1 - self.x0

    @property
    def height(self) -> int:
        """Number of rows."""
        return self.y1 - self.y0

    @property
    def corners(self) -> Array:
        """Centres of the four corner pixels of a plane box, (4, 2)."""
        left, top, right, bottom = self.x0, self.y0, self.x1 - 1, self.y1 - 1
        return np.array([[left, top], [right, top], [left, bottom], [right, bottom]], dtype=np.float64)

    def describe(self) -> str:
        """Say how large it is: columns x rows."""
        return " x ".join(map(str, self.sizes))

    @property
    def n_pixels(self) -> int:
        """Number of pixels."""
        sizes = self.sizes
        return prod(sizes) if min(sizes) > 0 else 0

    def grow(self, halo: int) -> Window:
        """Extend on every side by ``halo`` pixels; the result may leave the image."""
        return Window(tuple([first - halo for first in self.lower]), tuple([last + halo for last in self.upper]))

    def refine(self, factor: int) -> Window:
        """Give the same box in pixels of which ``factor`` x ``factor`` make one of these."""
        return Window(tuple([factor * first for first in self.lower]), tuple([factor * last for last in self.upper]))

    def intersection(self, other: Window) -> Window:
        """Find the common part of two boxes, which may be empty, with an upper corner that is not above the lower."""
        return Window(tuple(map(max, self.lower, other.lower)), tuple(map(min, self.upper, other.upper)))

    def union(self, other: Window) -> Window:
        """Find the smallest box that holds two."""
        return Window(tuple(map(min, self.lower, other.lower)), tuple(map(max, self.upper, other.upper)))

    def locate(self, part: Window) -> tuple[slice, ...]:
        """Find a part of this box in an array of its pixels: slices of rows and columns."""
        first, stop = map(sub, part.lower, self.lower), map(sub, part.upper, self.lower)
        return tuple(map(slice, first, stop))[::-1]

    def locate_inside(self, part: Window) -> tuple[slice, ...]:
        """Find a part of an image of this extent; raises ValueError where it leaves the image or is empty."""
        if part.n_pixels == 0 or not self.contains(part):
            raise ValueError(f"{part} is empty or leaves the image of {self.describe()} pixels")
        return self.locate(part)

    def index(self, pixels: IntArray) -> tuple[IntArray, ...]:
        """Find pixels, (n, dim), columns before rows, in an array of this box: numbers along each of its axes."""
        return tuple((pixels - self.lower).T[::-1])

    def contains(self, other: Window) -> bool:
        """Tell whether another box lies inside."""
        return all(map(le, self.lower, other.lower)) and all(map(ge, self.upper, other.upper))

    def take_rows(self, begin: int, end: int, axis: int = -1) -> Window:
        """Take the rows from ``begin`` to before ``end``: slabs across the last axis, or another one."""
        lower, upper = list(self.lower), list(self.upper)
        lower[axis], upper[axis] = begin, end
        return Window(tuple(lower), tuple(upper))

    def split_rows(self, height: int, step: int | None = None, axis: int = -1) -> Iterator[Window]:
        """Split into bands of ``height`` rows, the last one maybe lower, from top to bottom.

        Bands begin every ``step`` rows; by default they follow each other without a gap. ``axis`` is as for
        ``take_rows``.
        """
        end = self.upper[axis]
        for begin in range(self.lower[axis], end, step or height):
            yield self.take_rows(begin, min(begin + height, end), axis)


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
