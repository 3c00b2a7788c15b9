"""Pixels and cells of a frame that count for nothing, since they do not show the specimen's speckle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.view import FrameView
from ddic.mesh.raster import find_common_pixels
from ddic.parallel.team import Team
from ddic.problem.residual_model import ResidualModel
from ddic.problem.views import FrameViews

KEPT, BLANK, SPOILT, UNSEEN, HELD_BACK = 0, 1, 2, 3, 4
"""Cells: used, of no texture, of something else than the specimen, or of too few pixels that the frame shows; and
those that mechanics hold back from where the frame shows them, whose pixels count as they did at the start."""

PIXELS_CHANGED = 0.1
"""Share of the spoilt pixels that must come or go for a field to be sought again."""


@dataclass(frozen=True, eq=False)
class Exclusions:
    """What is excluded of a frame.

    Attributes
    ----------
    cells : list of tuple of (n_cells,) uint8 array
        KEPT or why not, by owned subdomain and view.
    pixels : list of tuple of (n, 2) int64 array
        Column and row of spoilt pixels in cells that are kept, likewise.
    """

    cells: list[tuple[NDArray[np.uint8], ...]]
    pixels: list[tuple[NDArray[np.int64], ...]]

    @classmethod
    def nothing(cls, views: Sequence[FrameViews]) -> Exclusions:
        """Exclude nothing.

        Parameters
        ----------
        views : sequence of FrameViews
            Owned subdomains.

        Returns
        -------
        Exclusions
            Of these.
        """
        cells = [tuple(np.full(view.view.correlation.mesh.n_cells, KEPT, dtype=np.uint8) for view in of_subdomain.views)
                 for of_subdomain in views]
        pixels = [tuple(np.zeros((0, 2), dtype=np.int64) for _ in of_subdomain.views) for of_subdomain in views]
        return cls(cells, pixels)

    def is_any(self, team: Team) -> bool:
        """Tell whether anything is excluded; collective.

        Parameters
        ----------
        team : Team
            All ranks.

        Returns
        -------
        bool
            The same on all ranks.
        """
        n = sum(int(states.any()) for states in self._states) + sum(len(spots) for spots in self._spots)
        return bool(team.sum(n) > 0)

    def join(self, other: Exclusions) -> Exclusions:
        """Exclude what either does.

        Parameters
        ----------
        other : Exclusions
            Of the same subdomains.

        Returns
        -------
        Exclusions
            Of both.
        """
        cells = [tuple(np.where(a == KEPT, b, a) for a, b in zip(one, two, strict=True))
                 for one, two in zip(self.cells, other.cells, strict=True)]
        pixels = [tuple(np.unique(np.concatenate([a, b]), axis=0) for a, b in zip(one, two, strict=True))
                  for one, two in zip(self.pixels, other.pixels, strict=True)]
        return Exclusions(cells, pixels)

    def hold_back(self, cells: Sequence[tuple[NDArray[np.bool_], ...]]) -> Exclusions:
        """Take cells that are seen for held back.

        Parameters
        ----------
        cells : sequence of tuple of (n_cells,) bool array
            Which, by owned subdomain and view.

        Returns
        -------
        Exclusions
            The others as before.
        """
        states = [tuple(np.where(is_held & np.isin(state, (KEPT, SPOILT)), HELD_BACK, state).astype(np.uint8)
                        for is_held, state in zip(*of_views, strict=True))
                  for of_views in zip(cells, self.cells, strict=True)]
        return replace(self, cells=states)

    @property
    def held_back(self) -> list[tuple[NDArray[np.bool_], ...]]:
        """Which cells are held back, (n_cells,), by owned subdomain and view."""
        return [tuple(states == HELD_BACK for states in of_subdomain) for of_subdomain in self.cells]

    def has_held_back(self, team: Team) -> bool:
        """Tell whether any cell is held back; collective.

        Parameters
        ----------
        team : Team
            All ranks.

        Returns
        -------
        bool
            The same on all ranks.
        """
        return bool(team.sum(sum(int((states == HELD_BACK).sum()) for states in self._states)) > 0)

    def count_cells(self, team: Team) -> int:
        """Count the cells of all ranks that are excluded; collective.

        Parameters
        ----------
        team : Team
            All ranks.

        Returns
        -------
        int
            By view.
        """
        return int(team.sum(sum(int((states != KEPT).sum()) for states in self._states)))

    def is_other_than(self, team: Team, other: Exclusions) -> bool:
        """Tell whether another excludes other cells, or much more or less of the pixels; collective.

        Parameters
        ----------
        team : Team
            All ranks.
        other : Exclusions
            Of the same subdomains.

        Returns
        -------
        bool
            The same on all ranks.
        """
        n_cells = sum(int(((find_excluded(a) != find_excluded(b)) | ((a == HELD_BACK) != (b == HELD_BACK))).sum())
                      for a, b in zip(self._states, other._states, strict=True))
        # One by one: a spot that has moved covers as many others.
        n_changed = sum(len(a) + len(b) - 2 * int(find_common_pixels(a, b).sum())
                        for a, b in zip(self._spots, other._spots, strict=True))
        n_pixels = sum(len(a) for a in self._spots)
        n_cells, n_changed, n_pixels = team.sum(np.array([n_cells, n_changed, n_pixels], dtype=float))
        return bool(n_cells > 0 or n_changed > PIXELS_CHANGED * max(n_pixels, 1.0))

    @property
    def _states(self) -> list[NDArray[np.uint8]]:
        """States of the cells of all views, subdomain by subdomain."""
        return [states for of_subdomain in self.cells for states in of_subdomain]

    @property
    def _spots(self) -> list[NDArray[np.int64]]:
        """Spoilt pixels of all views, in the same order."""
        return [spots for of_subdomain in self.pixels for spots in of_subdomain]


def find_excluded(states: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Find the cells none of whose pixels counts.

    Parameters
    ----------
    states : (n_cells,) uint8 array
        Of a view.

    Returns
    -------
    (n_cells,) bool array
        Which.
    """
    return np.asarray((states != KEPT) & (states != HELD_BACK))


def exclude(model: ResidualModel, excluded: Exclusions) -> ResidualModel:
    """Exclude pixels and cells of a frame from M and b.

    Parameters
    ----------
    model : ResidualModel
        With all pixels that the frame shows.
    excluded : Exclusions
        Of its subdomains.

    Returns
    -------
    ResidualModel
        With the others.
    """
    left = []
    for of_subdomain, cells, pixels in zip(model.views, excluded.cells, excluded.pixels, strict=True):
        views = tuple(_exclude_from_view(*of_view) for of_view in zip(of_subdomain.views, cells, pixels, strict=True))
        left.append(replace(of_subdomain, views=views))
    return replace(model, views=left)


def _exclude_from_view(view: FrameView, cells: NDArray[np.uint8], pixels: NDArray[np.int64]) -> FrameView:
    is_excluded = find_excluded(cells)
    if not is_excluded.any() and not len(pixels):
        return view
    correlation = view.view.correlation
    image = correlation.reference
    excluded = correlation.raster.draw_cells(np.flatnonzero(is_excluded), image.window) > 0
    excluded[pixels[:, 1] - image.window.y0, pixels[:, 0] - image.window.x0] = True
    kept = replace(correlation, reference=image.exclude(excluded))
    return replace(view, view=replace(view.view, correlation=kept))
