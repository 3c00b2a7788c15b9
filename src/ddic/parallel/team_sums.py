"""Sums over bands of rows that are spread over ranks."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ddic.parallel.team import Team
from ddic.separated.band_sums import BandSums, build_tree, join_trees

Array = NDArray[np.float64]
T = TypeVar("T")


@dataclass(frozen=True)
class TeamSums(BandSums):
    """Each rank owns some bands that follow each other; every call is collective.

    Attributes
    ----------
    team : Team
        All ranks.
    first : int
        Number of this rank's first band.
    """

    team: Team
    first: int

    def add_up(self, of_bands: Iterable[Array]) -> Array:
        """Sum arrays of one shape; only sums of groups of bands are sent."""
        tree = build_tree(self.first, of_bands)
        return tree.finish() if self.team.size == 1 else join_trees(self.team.gather_lists([tree.groups]))

    def join(self, of_bands: Iterable[Array]) -> Array:
        """Put arrays side by side along their last axis."""
        own = list(of_bands)
        return np.concatenate(own if self.team.size == 1 else self.team.gather_lists(own), axis=-1)

    def broadcast(self, item: T) -> T:
        """Give all ranks what rank 0 has."""
        return item if self.team.size == 1 else self.team.broadcast(item)

    def together(self, work: Callable[[], T]) -> T:
        """Run work on every rank; an error of one is raised on all."""
        return self.team.together(work)
