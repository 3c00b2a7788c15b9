"""Pixels and cells of a frame that count for nothing, since they do not show the specimen's speckle; and which do not.

A cell stands out where its residual is that of a displacement error beyond a limit, more than noise explains. If some
of its pixels are spoilt, these are excluded, and the whole cell where they are many. If none is by itself, the cell is
excluded for now: where its neighbours put it, it may be seen again. Cells beside what is excluded that hold one of
their nodes by a few pixels only are weak: they go too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, BoolArray, IntArray
from ddic.errors import ConvergenceError, as_collective
from ddic.functionals.spoilt_pixels import cut_patches, find_spoilt_pixels
from ddic.functionals.view import FrameView
from ddic.images.window import Window
from ddic.mesh.mesh import pad_cells
from ddic.mesh.plane import measure_distance
from ddic.mesh.raster import find_common_pixels
from ddic.parallel.distribution import sum_shared_nodes
from ddic.parallel.field import ByView, Field
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.problem.held_cells import CAPTURED, HeldCells, find_cells_beside, measure_mean_distance, pull_view
from ddic.problem.residual_model import ResidualModel
from ddic.visibility.seen_cells import FEWEST_PIXELS, SeenCells, TypicalCell, find_blank, find_standing_out

KEPT, BLANK, SPOILT, UNSEEN, HELD_OFF, MASKED = 0, 1, 2, 3, 4, 5
"""Cells: used, of no texture, of something else than the specimen, or of too few pixels that the frame shows; used
though the frame shows them pixels beside where mechanics hold them; and of no pixel of the reference image that
counts."""

PIXELS_CHANGED = 0.1
"""Share of the spoilt pixels that must come or go for a field to be sought again."""

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


@dataclass(frozen=True)
class Limits:
    """From which displacement error on a residual is not believed.

    Attributes
    ----------
    cell, pixel : float
        Of a whole cell, and about a pixel, pixels.
    searched : float
        Of a cell from which on single pixels of it are looked at, pixels.
    beside : float
        Distance up to which a cell that is seen beside where it is put counts nevertheless, pixels.
    """

    cell: float
    pixel: float
    searched: float
    beside: float


AT_START, AT_END = Limits(0.8, 1.0, 0.8, CAPTURED), Limits(0.6, 0.5, 0.15, np.inf)
"""Where the field is a start, and where it is found, which mechanics may hold off by any distance. Real images of
coarse meshes leave 0.46 px in a cell of little texture at the edge of a hole, and less than 0.3 px elsewhere."""

NO_LIMITS = Limits(np.inf, np.inf, np.inf, np.inf)
"""Where any residual is believed."""


@dataclass(frozen=True, eq=False)
class Exclusions:
    """What is excluded of a frame.

    Attributes
    ----------
    cells : ByView of (n_cells,) uint8 array
        KEPT or why not.
    pixels : ByView of (n, dim) int64 array
        Column and row of spoilt pixels in cells that are kept.
    pulled : ByView of HeldCells
        Cells that are pulled to where they are seen.
    """

    cells: ByView[NDArray[np.uint8]]
    pixels: ByView[IntArray]
    pulled: ByView[HeldCells]

    @classmethod
    def of_reference(cls, views: ByView[FrameView]) -> Exclusions:
        """Exclude of owned subdomains what the reference image masks, whatever a frame shows."""
        return cls(views.map(lambda view: np.where(find_masked(view), MASKED, KEPT).astype(np.uint8)),
                   views.map(lambda view: np.zeros((0, view.correlation.mesh.dim), dtype=np.int64)),
                   views.map(lambda view: HeldCells.none(view.correlation.mesh)))

    def is_any(self, team: Team) -> bool:
        """Tell all ranks whether anything is excluded; collective."""
        n = sum(int(find_excluded(states).any()) for states in self.cells.flat)
        return bool(team.sum(n + sum(len(spots) for spots in self.pixels.flat)) > 0)

    def join(self, other: Exclusions) -> Exclusions:
        """Exclude what either does; both are of the same subdomains."""
        cells = self.cells.map(lambda a, b: np.where(find_excluded(a), a, b), other.cells)
        pixels = self.pixels.map(lambda a, b: np.unique(np.concatenate([a, b]), axis=0), other.pixels)
        return Exclusions(cells, pixels, other.pulled)

    def intersect(self, now: Exclusions) -> Exclusions:
        """Exclude only cells that a later look would exclude too."""
        return replace(self, cells=self.cells.map(lambda a, b: np.where(find_excluded(b), a, b), now.cells))

    def keep_pulled(self, before: Exclusions, model: ResidualModel, q: Field) -> Exclusions:
        """Pull also what was pulled before and is still far from where it was seen."""
        return replace(self, pulled=self.pulled.map(HeldCells.keep, before.pulled, model.views, model.views.fill(q)))

    def has_held_off(self, team: Team) -> bool:
        """Tell whether any cell is seen beside where mechanics hold it; collective."""
        return bool(team.sum(sum(int((states == HELD_OFF).sum()) for states in self.cells.flat)) > 0)

    def with_marks(self, now: Exclusions) -> Exclusions:
        """Mark cells by what a later look says of them, where that excludes the same."""
        cells = self.cells.map(lambda a, b: np.where(find_excluded(a) == find_excluded(b), b, a), now.cells)
        return replace(self, cells=cells)

    def count_pixels(self, model: ResidualModel) -> int:
        """Count the pixels of all ranks that are excluded of a model with all; collective."""
        of_cells = model.views.map(lambda view, states: view.count_pixels()[find_excluded(states)], self.cells)
        n = sum(int(n_pixels.sum()) for n_pixels in of_cells.flat) + sum(len(spots) for spots in self.pixels.flat)
        return int(model.team.sum(n))

    def is_other_than(self, team: Team, other: Exclusions) -> bool:
        """Tell all ranks whether another excludes other cells, or much more or less of the pixels; collective."""
        n_cells = sum(self.cells.map(lambda a, b: int((find_excluded(a) != find_excluded(b)).sum()), other.cells).flat)
        n_cells += sum(self.pulled.map(lambda a, b: len(np.setxor1d(a.cells, b.cells)), other.pulled).flat)
        # One by one: a spot that has moved covers as many others.
        n_changed = sum(self.pixels.map(lambda a, b: len(a) + len(b) - 2 * int(find_common_pixels(a, b).sum()),
                                        other.pixels).flat)
        n_pixels = sum(len(spots) for spots in self.pixels.flat)
        n_cells, n_changed, n_pixels = team.sum(np.array([n_cells, n_changed, n_pixels], dtype=float))
        return bool(n_cells > 0 or n_changed > PIXELS_CHANGED * max(n_pixels, 1.0))


def find_masked(view: FrameView) -> BoolArray:
    """Find the cells of a view, (n_cells,), of which no pixel of the reference image counts."""
    is_masked = view.count_pixels() == 0
    parts = view.correlation.mesh.parts
    if parts is not None:
        # What lies wholly in the band of a line nothing hides: it follows its neighbours.
        is_masked[parts.cells] = False
    return np.asarray(is_masked)


def find_excluded(states: NDArray[np.uint8]) -> BoolArray:
    """Find the cells of a view, (n_cells,), none of whose pixels counts."""
    return np.asarray((states != KEPT) & (states != HELD_OFF))


def exclude(model: ResidualModel, excluded: Exclusions) -> ResidualModel:
    """Exclude pixels and cells of a frame from M and b."""
    return replace(model, views=model.views.map(_exclude_from_view, excluded.cells, excluded.pixels))


def _exclude_from_view(view: FrameView, cells: NDArray[np.uint8], pixels: IntArray) -> FrameView:
    is_excluded = find_excluded(cells)
    if not is_excluded.any() and not len(pixels):
        return view
    correlation = view.correlation
    image = correlation.reference
    excluded = correlation.raster.draw_cells(np.flatnonzero(is_excluded), image.window) > 0
    excluded[image.window.index(pixels)] = True
    return replace(view, correlation=replace(correlation, reference=image.exclude(excluded)))


def pull_held_cells(model: ResidualModel, excluded: Exclusions, q: Field) -> ResidualModel:
    """Pull the cells that are held off to where they are seen; collective."""
    pulled = model.team.together(lambda: model.views.map(partial(pull_view, follows=model.follows), model.views.fill(q),
                                                         excluded.pulled))
    n_pulled = sum(len(held.cells) for held in excluded.pulled.flat)
    return replace(model, pulled=pulled if model.team.sum(n_pulled) else None)


@dataclass(frozen=True, eq=False)
class _SeenView:
    """A view of a subdomain, with all pixels that the frame shows, at a displacement, and what a typical cell is like.

    ``judged``, (n_cells,), is what an earlier look found of these cells, from which is taken which of them are blank:
    noise correlates here and there, and they would come and go with the field. None where this one judges.
    """

    view: FrameView
    q: Array
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


def _find_view_exclusions(seen: _SeenView, rules: Rules) -> tuple[NDArray[np.uint8], IntArray, HeldCells]:
    """Find what a view does not show: states of its cells, spoilt pixels, cells that are pulled.

    States, (n_cells,), are KEPT or why not; pixels, (n, dim), are column and row of spoilt ones in cells that are kept;
    pulled are cells that are seen so far away that their grey levels say nothing of the way.
    """
    states = _judge_by_pixels(seen, rules)
    dim = seen.view.correlation.mesh.dim
    stands_out = find_standing_out(seen.cells, seen.typical, rules.limits.cell, dim)
    may_be_spoilt = find_standing_out(seen.cells, seen.typical, rules.limits.searched, dim)
    suspicious = np.flatnonzero((stands_out | may_be_spoilt) & (states == KEPT))
    # Without mechanics nothing is held off: what stands out is a mesh that cannot follow, or foreign.
    found = find_cells_beside(seen.view, seen.q, suspicious, seen.typical.noise) if rules.is_regularized else {}
    found = {cell: away for cell, away in found.items() if measure_mean_distance(away) <= rules.limits.beside}
    beside = np.array(list(found), dtype=np.int64)
    states[stands_out & (states == KEPT)] = SPOILT
    states[beside] = np.where(stands_out[beside], HELD_OFF, KEPT)
    spots = [np.zeros((0, dim), dtype=np.int64)]
    for cell, pixels, share in _search_cells(seen, rules, np.setdiff1d(suspicious, beside)):
        if share <= MOST_SPOILT:
            states[cell] = KEPT
            spots.append(pixels)
        else:
            # A cell that does not stand out is as good as the field can follow it.
            states[cell] = SPOILT if stands_out[cell] else KEPT
    return states, np.concatenate(spots), _hold(seen, found)


def _hold(seen: _SeenView, found: Mapping[int, Array]) -> HeldCells:
    """Where those cells are seen whose grey levels do not say the way there."""
    mesh = seen.view.correlation.mesh
    far = {cell: away for cell, away in found.items() if measure_mean_distance(away) > CAPTURED}
    if not far:
        return HeldCells.none(mesh)
    cells = np.array(list(far), dtype=np.int64)
    u = seen.view.kinematics.displacement(seen.q).reshape(mesh.nodes.shape)
    return HeldCells(cells, u[pad_cells(mesh)[cells]] + np.array(list(far.values())))


def _judge_by_pixels(seen: _SeenView, rules: Rules) -> NDArray[np.uint8]:
    """States of cells, (n_cells,), by their texture and by how many of their pixels the frame shows."""
    cells = seen.cells
    states = np.full(len(cells.n_pixels), KEPT, dtype=np.uint8)
    states[find_blank(cells, seen.typical) if seen.judged is None else seen.judged == BLANK] = BLANK
    least = 0.0 if rules.is_regularized else LEAST_SHOWN
    n_in_reference = seen.view.count_pixels()
    is_unseen = (cells.n_pixels == 0) | (cells.n_pixels < least * n_in_reference)
    states[is_unseen & (n_in_reference > 0)] = UNSEEN
    states[find_masked(seen.view)] = MASKED
    return states


def _search_cells(seen: _SeenView, rules: Rules, searched: IntArray) -> Iterator[tuple[int, IntArray, float]]:
    """Cells that have spoilt pixels, or that a line may cross elsewhere than it is thought to.

    Beside them these pixels' columns and rows, (n, dim), and their share of the cell's pixels that are judged.
    """
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
            pixels = np.column_stack(np.nonzero(spoilt)[::-1]) + box.lower
            yield cell, pixels, len(pixels) / max(n_judged, 1)


def _find_uncertain_pixels(seen: _SeenView, rules: Rules, box: Window) -> BoolArray:
    """Pixels of a box that may lie beyond a line: those within its uncertainty."""
    correlation = seen.view.correlation
    uncertain = np.zeros(box.shape, dtype=bool)
    if correlation.mesh.parts is None:
        return uncertain
    y, x = np.mgrid[box.y0:box.y1, box.x0:box.x1]
    points = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    for line, uncertainty in zip(correlation.mesh.parts.lines.polylines, rules.uncertainty, strict=True):
        if uncertainty > 0:
            uncertain |= (measure_distance(points, line) <= uncertainty).reshape(uncertain.shape)
    return uncertain


def exclude_weak_cells(whole: ResidualModel, excluded: Exclusions) -> Exclusions:
    """Exclude also the cells beside, one row at most, that hold one of their nodes by a few pixels only; collective."""
    team, subdomains = whole.team, whole.subdomains
    used = exclude(whole, excluded).views
    diagonals = team.together(lambda: [_sum_diagonals(*of_subdomain)
                                       for of_subdomain in zip(subdomains, used, excluded.cells, strict=True)])
    totals = team.sum(np.array([sum(d.sum() for d in diagonals), sum((d > 0).sum() for d in diagonals)], dtype=float))
    mean = totals[0] / max(totals[1], 1.0)
    are_beside = [_find_lost_nodes(*of_subdomain)
                  for of_subdomain in zip(subdomains, whole.views, excluded.cells, strict=True)]
    sums = sum_shared_nodes(team, subdomains, [np.column_stack(of_subdomain)
                                               for of_subdomain in zip(diagonals, are_beside, strict=True)])
    are_weak = [((n_beside > 0) & (held < LEAST_HELD * mean))[pad_cells(subdomain.mesh)].any(axis=1)
                for subdomain, (held, n_beside) in zip(subdomains, (s.T for s in sums), strict=True)]
    cells = excluded.cells.map(lambda states, is_weak: np.where(is_weak & ~find_excluded(states), UNSEEN,
                                                                states).astype(np.uint8), whole.views.fill(are_weak))
    return replace(excluded, cells=cells)


def _find_lost_nodes(subdomain: Subdomain, views: Sequence[FrameView],
                     states: Sequence[NDArray[np.uint8]]) -> BoolArray:
    """Nodes of cells that the reference images show and no camera sees: what they leave out holds none in any frame."""
    in_reference = np.sum([view.prepared.count_pixels() for view in views], axis=0)
    are_lost = np.all([find_excluded(state) for state in states], axis=0) & (in_reference > 0)
    nodes = np.zeros(subdomain.mesh.n_nodes, dtype=bool)
    nodes[pad_cells(subdomain.mesh)[are_lost]] = True
    return nodes


def _sum_diagonals(subdomain: Subdomain, views: Sequence[FrameView], states: Sequence[NDArray[np.uint8]]) -> Array:
    """Diagonal of M at the nodes of a subdomain, over components and cameras, (n_nodes,)."""
    mesh = subdomain.mesh
    total = np.zeros(mesh.n_nodes)
    for view, state in zip(views, states, strict=True):
        diagonal = np.einsum("cii->ci", view.correlation.compute_cell_hessians())
        of_corners = view.weight * diagonal.reshape(mesh.n_cells, -1, mesh.dim).sum(axis=2)
        is_used = ~find_excluded(state)
        np.add.at(total, pad_cells(mesh)[is_used], of_corners[is_used])
    return total


def find_exclusions(whole: ResidualModel, q: Field, seen: ByView[SeenCells],
                    typical: Mapping[int, TypicalCell], rules: Rules, judged: Exclusions | None) -> Exclusions:
    """Find what of a frame does not show the specimen, of owned subdomains; collective.

    ``whole`` holds all pixels that the frame shows. ``judged`` is of an earlier look, from which is taken which cells
    are blank; None where this one judges. Raises ConvergenceError on all ranks where most of the frame shows something
    else.
    """
    before = seen.map(lambda _: None) if judged is None else judged.cells
    views = whole.views.map(lambda view, q_s, cells, states: _SeenView(view, q_s, cells, typical[view.camera], states),
                            whole.views.fill(q), seen, before)
    chosen = replace(rules, limits=_choose_limits(whole.team, views.flat, rules.limits))
    found = whole.team.together(lambda: views.map(lambda seen: _find_view_exclusions(seen, chosen)))
    excluded = Exclusions(*(found.map(itemgetter(k)) for k in range(3)))
    # Mechanics hold what a frame does not show; what it shows beside something else is another matter.
    doubted = (BLANK, SPOILT) if rules.is_regularized else (BLANK, SPOILT, UNSEEN)
    n_doubted = sum(int(np.isin(states, doubted).any()) for states in excluded.cells.flat)
    return exclude_weak_cells(whole, excluded) if whole.team.sum(n_doubted) else excluded


def _choose_limits(team: Team, views: Sequence[_SeenView], limits: Limits) -> Limits:
    """Choose no limits where too much stands out at a start; raise where too much does later."""
    counts = np.zeros(2)
    for seen in views:
        stands_out = find_standing_out(seen.cells, seen.typical, limits.cell, seen.view.correlation.mesh.dim)
        counts += seen.cells.n_pixels.sum(), seen.cells.n_pixels[stands_out].sum()
    n_pixels, n_standing_out = team.sum(counts)
    if limits is AT_START and n_standing_out > START_SHARE * n_pixels:
        return NO_LIMITS
    if n_standing_out > LARGEST_SHARE * n_pixels:
        raise as_collective(ConvergenceError(
            f"{n_standing_out / n_pixels:.0%} of the pixels do not show in the deformed image what the field says: the "
            "start is wrong, or the images do not show the same surface; look at both, and give a start"))
    return limits
