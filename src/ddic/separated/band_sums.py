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

Place = tuple[int, int]
"""Level and number of a group of bands: group i of level l holds the bands i 2^l to (i + 1) 2^l - 1."""

Groups = dict[Place, Array]
"""Sums of groups that wait for a neighbour; two neighbours become one group as soon as both are there. Every rank comes
to the sum of all bands by the same additions, whichever bands it has seen itself."""


def divide_rows(along_y: LineElements) -> list[range]:
    """Divide the rows of a rectangle into N_BANDS bands, or one a row where there are fewer."""
    rows = along_y.pixels
    edges = np.linspace(rows.start, rows.stop, min(N_BANDS, len(rows)) + 1).round().astype(int)
    return [range(int(a), int(b)) for a, b in pairwise(edges)]


def sum_neighbours(first: int, of_bands: Iterable[Array]) -> Groups:
    """Sum arrays of one shape of bands that follow each other from number ``first``, as far as neighbours are there."""
    groups: Groups = {}
    for number, values in enumerate(of_bands, start=first):
        _add(groups, (0, number), values)
    return groups


def sum_groups(of_ranks: Iterable[Groups]) -> Array:
    """Sum the groups of all ranks; one group is left where the number of bands is a power of 2."""
    groups: Groups = {}
    for of_rank in of_ranks:
        for place, values in of_rank.items():
            _add(groups, place, values)
    total, *others = (groups[place] for place in sorted(groups, key=_first_band))
    return sum(others, start=total)


def _add(groups: Groups, place: Place, values: Array) -> None:
    """Add a group's sum."""
    level, number = place
    neighbour = groups.pop((level, number ^ 1), None)
    if neighbour is None:
        groups[place] = values
        return
    first, second = (neighbour, values) if number % 2 else (values, neighbour)
    _add(groups, (level + 1, number // 2), first + second)


def _first_band(place: Place) -> int:
    return place[1] << place[0]


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
