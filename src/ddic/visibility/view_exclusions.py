"""What a view of a subdomain does not show: states of its cells, and spoilt pixels of those that are kept.

A cell stands out where its residual is that of a displacement error beyond a limit, more than noise explains. If some
of its pixels are spoilt, these are excluded, and the whole cell where they are many. If none is by itself, the cell is
excluded for now: where its neighbours put it, it may be seen again. Cells beside what is excluded that hold one of
their nodes by a few pixels only are weak: they go too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ddic.errors import ConvergenceError, as_collective
from ddic.functionals.spoilt_pixels import cut_patches, find_spoilt_pixels
from ddic.functionals.view import FrameView
from ddic.images.window import Window
from ddic.mesh.mesh import pad_cells
from ddic.mesh.plane import measure_distance as measure_distance_from_line
from ddic.parallel.distribution import sum_shared_nodes
from ddic.parallel.team import Team
from ddic.problem.held_cells import (
    AT_START,
    CAPTURED,
    NO_LIMITS,
    HeldCells,
    Limits,
    find_cells_beside,
    measure_distance,
)
from ddic.problem.residual_model import ResidualModel
from ddic.problem.views import FrameViews
from ddic.visibility.exclusions import BLANK, HELD_OFF, KEPT, SPOILT, UNSEEN, Exclusions, exclude, find_excluded
from ddic.visibility.seen_cells import (
    BLANK_TEXTURE,
    CORRELATED,
    FEWEST_PIXELS,
    SeenCells,
    TypicalCell,
    find_standing_out,
)

Array = NDArray[np.float64]

MOST_SPOILT = 0.5
"""Share of a cell's pixels that may be spoilt; of a larger share the rest says little of its nodes."""

LEAST_SHOWN = 0.3
"""Share of a cell's pixels that a frame must show where no mechanics hold its nodes: of a smaller one, pixels that come
and go with the field hold some of them."""

LEAST_HELD = 0.1
"""Diagonal of M of a node beside what is excluded, relative to that of a node of the region in the mean, below which
the cells about it are excluded as well. A larger share loses more of them, a smaller one leaves nodes to noise."""

LARGEST_SHARE = 0.5
"""Share of the pixels that are shown which may be spoilt; of a larger one nobody knows which part is right."""

START_SHARE = 0.3
"""The same at a start, which may be wrong itself: with more, nothing is excluded before the first iterations."""


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
    own_brightness, is_regularized : bool
        Whether each cell has a gain and an offset of its own; whether mechanics hold what pixels do not.
    uncertainty : tuple of float
        How far each discontinuity may be from where it is thought to be, pixels.
    """

    limits: Limits
    own_brightness: bool
    is_regularized: bool
    uncertainty: tuple[float, ...] = ()


def find_view_exclusions(seen: SeenView, rules: Rules) -> tuple[NDArray[np.uint8], NDArray[np.int64], HeldCells]:
    """Find what a view does not show: states of its cells, spoilt pixels, cells that are pulled.

    States, (n_cells,), are KEPT or why not; pixels, (n, 2), are column and row of spoilt ones in cells that are kept;
    pulled are cells that are seen so far away that their grey levels say nothing of the way.
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
    n_in_reference = seen.view.view.count_pixels()
    is_unseen = (cells.n_pixels == 0) | (cells.n_pixels < least * n_in_reference)
    parts = seen.view.view.correlation.mesh.parts
    if parts is not None:
        # Of what lies wholly in the band of a line the frame hides nothing: it follows its neighbours.
        is_unseen[parts.cells] &= n_in_reference[parts.cells] > 0
    states[is_unseen] = UNSEEN
    return states


@dataclass(frozen=True, eq=False)
class _SpoiltPart:
    """Spoilt pixels of a cell, (n, 2) columns and rows, and their share of those that are judged."""

    cell: int
    pixels: NDArray[np.int64]
    share: float


def _search_cells(seen: SeenView, rules: Rules, searched: NDArray[np.int64]) -> Iterator[_SpoiltPart]:
    """Spoilt pixels of those cells that have some, or that a line may cross elsewhere than it is thought to."""
    # The correction of all cells, where each has none of its own.
    correction = seen.typical.gain, seen.typical.offset
    for cell, box, patch in cut_patches(seen.view, seen.q, searched, correction):
        of_lines = patch.counts & _find_uncertain_pixels(seen, rules, box)
        judged = patch.counts & ~of_lines
        n_judged = int(judged.sum())
        spoilt = np.zeros(judged.shape, dtype=bool)
        if n_judged >= FEWEST_PIXELS:
            spoilt = find_spoilt_pixels(replace(patch, counts=judged), seen.typical.noise, rules.limits.pixel,
                                        own_brightness=rules.own_brightness)
        if spoilt.any() or of_lines.any():
            rows, columns = np.nonzero(spoilt)
            yield _SpoiltPart(cell, np.column_stack([columns + box.x0, rows + box.y0]), len(rows) / max(n_judged, 1))


def _find_uncertain_pixels(seen: SeenView, rules: Rules, box: Window) -> NDArray[np.bool_]:
    """Pixels of a box that may lie beyond a line: those within its uncertainty."""
    correlation = seen.view.view.correlation
    uncertain = np.zeros((box.height, box.width), dtype=bool)
    if correlation.mesh.parts is None:
        return uncertain
    y, x = np.mgrid[box.y0:box.y1, box.x0:box.x1]
    points = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    for line, uncertainty in zip(correlation.mesh.parts.lines.polylines, rules.uncertainty, strict=True):
        if uncertainty > 0:
            uncertain |= (measure_distance_from_line(points, line) <= uncertainty).reshape(uncertain.shape)
    return uncertain


def exclude_weak_cells(whole: ResidualModel, excluded: Exclusions) -> Exclusions:
    """Exclude also the cells beside, one row at most, that hold one of their nodes by a few pixels only; collective."""
    team, subdomains = whole.team, [of_subdomain.subdomain for of_subdomain in whole.views]
    used = exclude(whole, excluded).views
    diagonals = team.together(lambda: [_sum_diagonals(of_subdomain, states)
                                       for of_subdomain, states in zip(used, excluded.cells, strict=True)])
    totals = team.sum(np.array([sum(d.sum() for d in diagonals), sum((d > 0).sum() for d in diagonals)], dtype=float))
    mean = totals[0] / max(totals[1], 1.0)
    are_beside = [_find_lost_nodes(*of_subdomain) for of_subdomain in zip(whole.views, excluded.cells, strict=True)]
    sums = sum_shared_nodes(team, subdomains, [np.column_stack(of_subdomain)
                                               for of_subdomain in zip(diagonals, are_beside, strict=True)])
    cells = []
    for subdomain, states, (held, n_beside) in zip(subdomains, excluded.cells, (s.T for s in sums), strict=True):
        is_weak = ((n_beside > 0) & (held < LEAST_HELD * mean))[pad_cells(subdomain.mesh)].any(axis=1)
        cells.append(tuple(np.where(is_weak & ~find_excluded(state), UNSEEN, state).astype(np.uint8)
                           for state in states))
    return replace(excluded, cells=cells)


def _find_lost_nodes(of_subdomain: FrameViews, states: Sequence[NDArray[np.uint8]]) -> NDArray[np.bool_]:
    """Nodes of cells that the reference images show and no camera sees: what they leave out holds none in any frame."""
    in_reference = np.sum([view.count_pixels() for view in of_subdomain.reference.views], axis=0)
    are_lost = np.all([find_excluded(state) for state in states], axis=0) & (in_reference > 0)
    nodes = np.zeros(of_subdomain.subdomain.mesh.n_nodes, dtype=bool)
    nodes[pad_cells(of_subdomain.subdomain.mesh)[are_lost]] = True
    return nodes


def _sum_diagonals(of_subdomain: FrameViews, states: Sequence[NDArray[np.uint8]]) -> Array:
    """Diagonal of M at the nodes of a subdomain, over components and cameras, (n_nodes,)."""
    mesh = of_subdomain.subdomain.mesh
    total = np.zeros(mesh.n_nodes)
    for view, state in zip(of_subdomain.views, states, strict=True):
        diagonal = np.einsum("cii->ci", view.view.correlation.compute_cell_hessians())
        of_corners = view.view.weight * diagonal.reshape(mesh.n_cells, -1, mesh.dim).sum(axis=2)
        is_used = ~find_excluded(state)
        np.add.at(total, pad_cells(mesh)[is_used], of_corners[is_used])
    return total


def find_exclusions(whole: ResidualModel, q: Sequence[Array], seen: Sequence[Sequence[SeenCells]],
                    typical: Mapping[int, TypicalCell], rules: Rules, judged: Exclusions | None) -> Exclusions:
    """Find what of a frame does not show the specimen, of owned subdomains; collective.

    ``whole`` holds all pixels that the frame shows. ``judged`` is of an earlier look, from which is taken which cells
    are blank; None where this one judges. Raises ConvergenceError on all ranks where most of the frame shows something
    else.
    """
    states_before = [(None,) * len(of_views) for of_views in seen] if judged is None else judged.cells
    views = [[SeenView(view, q_s, cells, typical[view.camera], states)
              for view, cells, states in zip(of_subdomain.views, *of_views, strict=True)]
             for of_subdomain, q_s, *of_views in zip(whole.views, q, seen, states_before, strict=True)]
    chosen = replace(rules, limits=_choose_limits(whole.team, views, rules.limits))
    excluded = whole.team.together(lambda: _find_in_views(views, chosen))
    # Mechanics hold what a frame does not show; what it shows beside something else is another matter.
    doubted = (BLANK, SPOILT) if rules.is_regularized else (BLANK, SPOILT, UNSEEN)
    n_doubted = sum(int(np.isin(state, doubted).any()) for of_subdomain in excluded.cells for state in of_subdomain)
    return exclude_weak_cells(whole, excluded) if whole.team.sum(n_doubted) else excluded


def _choose_limits(team: Team, views: Sequence[Sequence[SeenView]], limits: Limits) -> Limits:
    """Choose no limits where too much stands out at a start; raise where too much does later."""
    counts = np.zeros(2)
    for of_subdomain in views:
        for seen in of_subdomain:
            stands_out = find_standing_out(seen.cells, seen.typical, limits.cell)
            counts += seen.cells.n_pixels.sum(), seen.cells.n_pixels[stands_out].sum()
    n_pixels, n_standing_out = team.sum(counts)
    if limits is AT_START and n_standing_out > START_SHARE * n_pixels:
        return NO_LIMITS
    if n_standing_out > LARGEST_SHARE * n_pixels:
        raise as_collective(ConvergenceError(
            f"{n_standing_out / n_pixels:.0%} of the pixels do not show in the deformed image what the field says: the "
            "start is wrong, or the images do not show the same surface; look at both, and give a start"))
    return limits


def _find_in_views(views: Sequence[Sequence[SeenView]], rules: Rules) -> Exclusions:
    """What the views of owned subdomains do not show."""
    cells, pixels, pulled = [], [], []
    for of_subdomain in views:
        found = [find_view_exclusions(seen, rules) for seen in of_subdomain]
        cells.append(tuple(states for states, _, _ in found))
        pixels.append(tuple(spots for _, spots, _ in found))
        pulled.append(tuple(held for _, _, held in found))
    return Exclusions(cells, pixels, pulled)
