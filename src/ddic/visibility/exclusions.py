"""Pixels and cells of a frame that count for nothing, since they do not show the specimen's speckle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.view import FrameView
from ddic.mesh.raster import find_common_pixels
from ddic.parallel.team import Team
from ddic.problem.held_cells import HeldCells, PulledViews, pull_view
from ddic.problem.residual_model import ResidualModel
from ddic.problem.views import FrameViews

KEPT, BLANK, SPOILT, UNSEEN, HELD_OFF = 0, 1, 2, 3, 4
"""Cells: used, of no texture, of something else than the specimen, or of too few pixels that the frame shows; and used
though the frame shows them pixels beside where mechanics hold them."""

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
    pulled : list of tuple of HeldCells
        Cells that are pulled to where they are seen, likewise.
    """

    cells: list[tuple[NDArray[np.uint8], ...]]
    pixels: list[tuple[NDArray[np.int64], ...]]
    pulled: list[tuple[HeldCells, ...]]

    @classmethod
    def nothing(cls, views: Sequence[FrameViews]) -> Exclusions:
        """Exclude nothing of owned subdomains."""
        cells = [tuple(np.full(view.view.correlation.mesh.n_cells, KEPT, dtype=np.uint8) for view in of_subdomain.views)
                 for of_subdomain in views]
        pixels = [tuple(np.zeros((0, 2), dtype=np.int64) for _ in of_subdomain.views) for of_subdomain in views]
        return cls(cells, pixels, [tuple(HeldCells.none() for _ in of_subdomain.views) for of_subdomain in views])

    def is_any(self, team: Team) -> bool:
        """Tell all ranks whether anything is excluded; collective."""
        n = sum(int(find_excluded(states).any()) for states in self._states) + sum(len(spots) for spots in self._spots)
        return bool(team.sum(n) > 0)

    def join(self, other: Exclusions) -> Exclusions:
        """Exclude what either does; both are of the same subdomains."""
        cells = [tuple(np.where(find_excluded(a), a, b) for a, b in zip(one, two, strict=True))
                 for one, two in zip(self.cells, other.cells, strict=True)]
        pixels = [tuple(np.unique(np.concatenate([a, b]), axis=0) for a, b in zip(one, two, strict=True))
                  for one, two in zip(self.pixels, other.pixels, strict=True)]
        return Exclusions(cells, pixels, other.pulled)

    def intersect(self, now: Exclusions) -> Exclusions:
        """Exclude only cells that a later look would exclude too."""
        cells = [tuple(np.where(find_excluded(b), a, b) for a, b in zip(one, two, strict=True))
                 for one, two in zip(self.cells, now.cells, strict=True)]
        return replace(self, cells=cells)

    def keep_pulled(self, before: Exclusions, model: ResidualModel, q: Sequence[NDArray[np.float64]]) -> Exclusions:
        """Pull also what was pulled before and is still far from where it was seen."""
        pulled = [tuple(now.keep(then, view.view, q_s)
                        for now, then, view in zip(of_views, seen, of_subdomain.views, strict=True))
                  for of_views, seen, of_subdomain, q_s
                  in zip(self.pulled, before.pulled, model.views, q, strict=True)]
        return replace(self, pulled=pulled)

    def has_held_off(self, team: Team) -> bool:
        """Tell whether any cell is seen beside where mechanics hold it; collective."""
        return bool(team.sum(sum(int((states == HELD_OFF).sum()) for states in self._states)) > 0)

    def with_marks(self, now: Exclusions) -> Exclusions:
        """Mark cells by what a later look says of them, where that excludes the same."""
        cells = [tuple(np.where(find_excluded(a) == find_excluded(b), b, a) for a, b in zip(one, two, strict=True))
                 for one, two in zip(self.cells, now.cells, strict=True)]
        return replace(self, cells=cells)

    def count_pixels(self, model: ResidualModel) -> int:
        """Count the pixels of all ranks that are excluded of a model with all; collective."""
        views = [view.view for of_subdomain in model.views for view in of_subdomain.views]
        n = sum(int(view.count_pixels()[find_excluded(states)].sum()) + len(spots)
                for view, states, spots in zip(views, self._states, self._spots, strict=True))
        return int(model.team.sum(n))

    def is_other_than(self, team: Team, other: Exclusions) -> bool:
        """Tell all ranks whether another excludes other cells, or much more or less of the pixels; collective."""
        n_cells = sum(int((find_excluded(a) != find_excluded(b)).sum())
                      for a, b in zip(self._states, other._states, strict=True))
        n_cells += sum(len(np.setxor1d(a.cells, b.cells)) for one, two in zip(self.pulled, other.pulled, strict=True)
                       for a, b in zip(one, two, strict=True))
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
    """Find the cells of a view, (n_cells,), none of whose pixels counts."""
    return np.asarray((states != KEPT) & (states != HELD_OFF))


def exclude(model: ResidualModel, excluded: Exclusions) -> ResidualModel:
    """Exclude pixels and cells of a frame from M and b."""
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


def pull_held_cells(model: ResidualModel, excluded: Exclusions, q: Sequence[NDArray[np.float64]]) -> ResidualModel:
    """Pull the cells that are held off to where they are seen; collective."""
    pulled: PulledViews = model.team.together(lambda: [
        tuple(pull_view(view, q_s, held, follows=model.follows)
              for view, held in zip(of_subdomain.views, of_views, strict=True))
        for of_subdomain, of_views, q_s in zip(model.views, excluded.pulled, q, strict=True)])
    n_pulled = sum(len(held.cells) for of_views in excluded.pulled for held in of_views)
    return replace(model, pulled=pulled if model.team.sum(n_pulled) else None)
