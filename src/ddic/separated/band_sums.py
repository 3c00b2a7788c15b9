"""Sums over bands of rows that are rounded alike however bands are spread over ranks."""

from collections.abc import Callable, Iterable
from itertools import pairwise
from typing import Protocol, TypeVar

import numpy as np

from ddic.arrays import Array
from ddic.separated.field import LineElements

T = TypeVar("T")

N_BANDS = 16
"""Bands of rows, whatever the number of ranks: most ranks that have work. More of them make more and smaller sweeps."""

def divide_rows(along_y: LineElements) -> list[range]:
    """Divide the rows of a rectangle into N_BANDS bands, or one a row where there are fewer."""
    rows = along_y.pixels
    edges = np.linspace(rows.start, rows.stop, min(N_BANDS, len(rows)) + 1).round().astype(int)
    return [range(int(a), int(b)) for a, b in pairwise(edges)]


class BandSums(Protocol):
    """Brings together what bands of rows give; every rank has the result."""

    def add_up(self, of_bands: Iterable[Array]) -> Array:
        """Sum arrays of one shape, one of each owned band in order, over the bands of all ranks."""
        ...

    def join(self, of_bands: Iterable[Array]) -> Array:
        """Put arrays, one of each owned band in order, side by side along their last axis, those of all ranks."""
        ...

    def broadcast(self, item: T) -> T:
        """Give all ranks what the first one has, so that rounding lets none of them decide otherwise."""
        ...

    def together(self, work: Callable[[], T]) -> T:
        """Run work, free of communication, that may fail on one rank alone, and return its result."""
        ...
