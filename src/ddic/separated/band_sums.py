"""Sums over bands of rows that are rounded alike however bands are spread over ranks."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Protocol, TypeVar

import numpy as np

from ddic.arrays import Array
from ddic.separated.field import LineElements

T = TypeVar("T")

N_BANDS = 16
"""Bands of rows, whatever the number of ranks: most ranks that have work. More of them make more and smaller sweeps."""

Place = tuple[int, int]
"""Level and number of a group of bands: group i of level l holds the bands i 2^l to (i + 1) 2^l - 1."""


def divide_rows(along_y: LineElements) -> list[range]:
    """Divide the rows of a rectangle into N_BANDS bands, or one a row where there are fewer."""
    rows = along_y.pixels
    edges = np.linspace(rows.start, rows.stop, min(N_BANDS, len(rows)) + 1).round().astype(int)
    return [range(int(a), int(b)) for a, b in pairwise(edges)]


@dataclass
class BandTree:
    """Sums of groups of bands; two neighbours become one as soon as both are there.

    Every rank comes to the sum of all bands by the same additions, whichever bands it has seen itself.

    Attributes
    ----------
    groups : dict of array
        Sums that wait for a neighbour.
    """

    groups: dict[Place, Array] = field(default_factory=dict)

    def add(self, place: Place, values: Array) -> None:
        """Add a group's sum."""
        level, number = place
        neighbour = self.groups.pop((level, number ^ 1), None)
        if neighbour is None:
            self.groups[place] = values
            return
        first, second = (neighbour, values) if number % 2 else (values, neighbour)
        self.add((level + 1, number // 2), first + second)

    def finish(self) -> Array:
        """Sum what is left: one group where the number of bands is a power of 2."""
        total, *others = (self.groups[place] for place in sorted(self.groups, key=_first_band))
        for values in others:
            total = total + values
        return total


def _first_band(place: Place) -> int:
    return place[1] << place[0]


def build_tree(first: int, of_bands: Iterable[Array]) -> BandTree:
    """Sum arrays of one shape of bands that follow each other from number ``first``, as far as neighbours are there."""
    tree = BandTree()
    for number, values in enumerate(of_bands, start=first):
        tree.add((0, number), values)
    return tree


def join_trees(groups: Iterable[Mapping[Place, Array]]) -> Array:
    """Sum the groups of all ranks."""
    tree = BandTree()
    for of_rank in groups:
        for place, values in of_rank.items():
            tree.add(place, values)
    return tree.finish()


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
