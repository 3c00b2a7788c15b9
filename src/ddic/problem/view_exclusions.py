"""What a view of a subdomain does not show: states of its cells, and spoilt pixels of those that are kept."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.cut_patch import cut_patch
from ddic.functionals.spoilt_pixels import find_spoilt_pixels
from ddic.functionals.view import FrameView
from ddic.problem.exclusions import BLANK, HELD_BACK, KEPT, SPOILT, UNSEEN
from ddic.problem.residual_limits import Limits
from ddic.problem.seen_cells import FEWEST_PIXELS, SeenCells, TypicalCell
from ddic.problem.standing_out import BLANK_TEXTURE, CORRELATED, find_standing_out

MOST_SPOILT = 0.5
"""Share of a cell's pixels that may be spoilt; of a larger share the rest says little of its nodes."""

LEAST_SHOWN = 0.3
"""Share of a cell's pixels that a frame must show where no mechanics hold its nodes: of a smaller one, pixels that come
and go with the field hold some of them."""


@dataclass(frozen=True, eq=False)
class SeenView:
    """A view of a subdomain in a frame, at a displacement.

    Attributes
    ----------
    view : FrameView
        With all pixels that the frame shows.
    q : (n_unknowns,) array
        The subdomain's unknowns.
    cells : SeenCells
        Its cells.
    typical : TypicalCell
        Of the camera.
    is_displaced : (n_cells,) bool array
        Cells that are not where they were seen at the start.
    is_held_back : (n_cells,) bool array
        Those of them that stand out: mechanics hold them back.
    """

    view: FrameView
    q: NDArray[np.float64]
    cells: SeenCells
    typical: TypicalCell
    is_displaced: NDArray[np.bool_]
    is_held_back: NDArray[np.bool_]


@dataclass(frozen=True)
class Rules:
    """By which cells and pixels are excluded.

    Attributes
    ----------
    limits : Limits
        From which error on a residual is not believed.
    own_brightness : bool
        Whether each cell has a gain and an offset of its own.
    is_regularized : bool
        Whether mechanics hold what pixels do not.
    """

    limits: Limits
    own_brightness: bool
    is_regularized: bool


def find_view_exclusions(seen: SeenView, rules: Rules) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Find what a view does not show.

    Parameters
    ----------
    seen : SeenView
        Of a frame.
    rules : Rules
        Which hold for all views.

    Returns
    -------
    states : (n_cells,) uint8 array
        KEPT or why not.
    pixels : (n, 2) int64 array
        Column and row of spoilt pixels in cells that are kept.
    """
    states = _judge_by_pixels(seen, rules)
    states[seen.is_held_back & (states == KEPT)] = HELD_BACK
    stands_out = find_standing_out(seen.cells, seen.typical, rules.limits.cell)
    states[stands_out & (states == KEPT)] = SPOILT
    may_be_spoilt = find_standing_out(seen.cells, seen.typical, rules.limits.searched)
    # What mechanics hold off leaves residuals, spoilt or not.
    may_be_spoilt &= ~seen.is_displaced
    searched = np.flatnonzero(may_be_spoilt & ((states == KEPT) | (states == SPOILT)))
    spots = [np.zeros((0, 2), dtype=np.int64)]
    for found in _search_cells(seen, rules, searched):
        if found.share <= MOST_SPOILT:
            states[found.cell] = KEPT
            spots.append(found.pixels)
        else:
            # A cell that does not stand out is as good as the field can follow it.
            states[found.cell] = SPOILT if stands_out[found.cell] else KEPT
    return states, np.concatenate(spots)


def _judge_by_pixels(seen: SeenView, rules: Rules) -> NDArray[np.uint8]:
    """States of cells, (n_cells,), by their texture and by how many of their pixels the frame shows."""
    cells, typical = seen.cells, seen.typical
    states = np.full(len(cells.n_pixels), KEPT, dtype=np.uint8)
    # Where nothing has texture at all, the operators say so.
    is_weak = (cells.texture <= BLANK_TEXTURE * typical.texture) & (typical.texture > 0)
    states[is_weak & (cells.coefficient < CORRELATED) & (cells.n_pixels >= FEWEST_PIXELS)] = BLANK
    least = 0.0 if rules.is_regularized else LEAST_SHOWN
    states[(cells.n_pixels == 0) | (cells.n_pixels < least * seen.view.view.count_pixels())] = UNSEEN
    return states


@dataclass(frozen=True, eq=False)
class _SpoiltPart:
    """Spoilt pixels of a cell, (n, 2) columns and rows, and their share of those that count."""

    cell: int
    pixels: NDArray[np.int64]
    share: float


def _search_cells(seen: SeenView, rules: Rules, searched: NDArray[np.int64]) -> Iterator[_SpoiltPart]:
    """Spoilt pixels of those cells that have some."""
    if not len(searched):
        return
    correlation = seen.view.view.correlation
    residual = seen.view.compute_residual_image(seen.q)
    # That of all cells, where each has none of its own.
    correction = seen.typical.gain, seen.typical.offset
    for cell in searched.tolist():
        box, patch = cut_patch(correlation, residual, cell, correction)
        n_counted = int(patch.counts.sum())
        if n_counted < FEWEST_PIXELS:
            continue
        spoilt = find_spoilt_pixels(patch, seen.typical.noise, rules.limits.pixel, own_brightness=rules.own_brightness)
        if spoilt.any():
            rows, columns = np.nonzero(spoilt)
            yield _SpoiltPart(cell, np.column_stack([columns + box.x0, rows + box.y0]), len(rows) / n_counted)
