"""What a view of a subdomain does not show: states of its cells, and spoilt pixels of those that are kept."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.cut_patch import cut_patch
from ddic.functionals.spoilt_pixels import find_spoilt_pixels
from ddic.functionals.view import FrameView
from ddic.mesh.shapes import pad_cells
from ddic.problem.exclusions import BLANK, HELD_OFF, KEPT, SPOILT, UNSEEN
from ddic.problem.held_cells import HeldCells
from ddic.problem.residual_limits import CAPTURED, Limits
from ddic.problem.seek_cells import find_cells_beside, measure_distance
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
    judged : (n_cells,) uint8 array or None
        What an earlier look found of these cells, from which is taken which of them are blank: noise correlates here
        and there, and they would come and go with the field. None where this one judges.
    """

    view: FrameView
    q: NDArray[np.float64]
    cells: SeenCells
    typical: TypicalCell
    judged: NDArray[np.uint8] | None


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


def find_view_exclusions(seen: SeenView, rules: Rules) -> tuple[NDArray[np.uint8], NDArray[np.int64], HeldCells]:
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
    pulled : HeldCells
        Cells that are seen so far away that their grey levels say nothing of the way.
    """
    states = _judge_by_pixels(seen, rules)
    stands_out = find_standing_out(seen.cells, seen.typical, rules.limits.cell)
    may_be_spoilt = find_standing_out(seen.cells, seen.typical, rules.limits.searched)
    suspicious = np.flatnonzero((stands_out | may_be_spoilt) & (states == KEPT))
    found = _find_cells_beside(seen, rules, suspicious)
    beside = np.array(list(found), dtype=np.int64)
    states[stands_out & (states == KEPT)] = SPOILT
    states[beside] = np.where(stands_out[beside], HELD_OFF, KEPT)
    spots = [np.zeros((0, 2), dtype=np.int64)]
    for part in _search_cells(seen, rules, np.setdiff1d(suspicious, beside)):
        if part.share <= MOST_SPOILT:
            if states[part.cell] == SPOILT:
                states[part.cell] = KEPT
            spots.append(part.pixels)
        else:
            # A cell that does not stand out is as good as the field can follow it.
            states[part.cell] = SPOILT if stands_out[part.cell] else KEPT
    return states, np.concatenate(spots), _hold(seen, found)


def _find_cells_beside(seen: SeenView, rules: Rules, cells: NDArray[np.int64]) -> dict[int, NDArray[np.float64]]:
    """How far the corners of some cells are seen beside where mechanics hold them, of those that are."""
    if not rules.is_regularized:
        # No mechanics hold anything off: what stands out is a mesh that cannot follow, or foreign.
        return {}
    found = find_cells_beside(seen.view, seen.q, cells, seen.typical.noise)
    return {cell: away for cell, away in found.items() if measure_distance(away) <= rules.limits.beside}


def _hold(seen: SeenView, found: Mapping[int, NDArray[np.float64]]) -> HeldCells:
    """Where those cells are seen whose grey levels do not say the way there."""
    far = {cell: away for cell, away in found.items() if measure_distance(away) > CAPTURED}
    if not far:
        return HeldCells.none()
    cells, mesh = np.array(list(far), dtype=np.int64), seen.view.view.correlation.mesh
    u = seen.view.view.kinematics.displacement(seen.q).reshape(mesh.nodes.shape)
    return HeldCells(cells, u[pad_cells(mesh)[cells]] + np.array(list(far.values())))


def _judge_by_pixels(seen: SeenView, rules: Rules) -> NDArray[np.uint8]:
    """States of cells, (n_cells,), by their texture and by how many of their pixels the frame shows."""
    cells, typical = seen.cells, seen.typical
    states = np.full(len(cells.n_pixels), KEPT, dtype=np.uint8)
    if seen.judged is None:
        # Where nothing has texture at all, the operators say so.
        is_weak = (cells.texture <= BLANK_TEXTURE * typical.texture) & (typical.texture > 0)
        is_blank = is_weak & (cells.coefficient < CORRELATED) & (cells.n_pixels >= FEWEST_PIXELS)
    else:
        is_blank = seen.judged == BLANK
    states[is_blank] = BLANK
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
