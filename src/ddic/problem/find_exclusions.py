"""What of a frame does not show the specimen, found from the residual.

A cell stands out where its residual is that of a displacement error beyond a limit, more than noise explains. If some
of its pixels are spoilt, these are excluded, and the whole cell where they are many. If none is by itself, the cell is
excluded for now: where its neighbours put it, it may be seen again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.errors import ConvergenceError, as_collective
from ddic.functionals.correlation import Correlation
from ddic.functionals.spoilt_pixels import CellPatch, find_spoilt_pixels
from ddic.functionals.view import FrameView
from ddic.problem.exclusions import BLANK, KEPT, SPOILT, UNSEEN, Exclusions
from ddic.problem.residual_model import ResidualModel
from ddic.problem.seen_cells import FEWEST_PIXELS, SeenCells, TypicalCell
from ddic.problem.weak_cells import exclude_weak_cells

Array = NDArray[np.float64]

SIGNIFICANT = 6.0
"""Standard deviations beyond which noise alone does not make a cell stand out: it does in one of 10^9."""

MOST_SPOILT = 0.5
"""Share of a cell's pixels that may be spoilt; of a larger share the rest says little of its nodes."""

LEAST_SHOWN = 0.3
"""Share of a cell's pixels that a frame must show where no mechanics hold its nodes: of a smaller one, pixels that come
and go with the field hold some of them."""


LEAST_EXCESS, OF_CONTRAST = 2.0, 10.0
"""Variance of a cell's residual, relative to the median, from which on it can stand out at all; and by how much more
when the median is as much as the contrast of the speckle: then it is no noise, and varies like the speckle."""

WEAK_TEXTURE, BLANK_TEXTURE = 0.1, 0.15
"""Mean |grad f|^2 of a cell relative to a textured one's: what a weaker one is taken for when its residual is judged,
and below which it may be blank."""

SAME_SPECKLE = 0.4
"""Correlation coefficient of f and g in a cell, relative to what its contrast and the noise let expect, below which
another part of the specimen is seen, however large the residual is everywhere. A larger share excludes more."""

UNEXPLAINED = 0.5
"""Share of the residual's variance that no translation explains from which on another part may be seen."""

CORRELATED = 0.3
"""Correlation coefficient of f and g from which on a cell of weak texture is seen nevertheless: noise of 400 pixels has
one of 0.05."""

LARGEST_SHARE = 0.5
"""Share of the pixels that are shown which may be spoilt; of a larger one nobody knows which part is right."""

START_SHARE = 0.3
"""The same at a start, which may be wrong itself: with more, nothing is excluded before the first iterations."""


@dataclass(frozen=True)
class Limits:
    """From which displacement error on a residual is not believed.

    Attributes
    ----------
    cell : float
        Of a whole cell, pixels.
    pixel : float
        About a pixel, pixels.
    searched : float
        Of a cell from which on single pixels of it are looked at, pixels.
    """

    cell: float
    pixel: float
    searched: float


AT_START, AT_END = Limits(0.8, 1.0, 0.8), Limits(0.6, 0.5, 0.15)
"""Where the field is a start, and where it is found. Real images of coarse meshes leave 0.46 px
in a cell of little texture at the edge of a hole, and less than 0.3 px elsewhere."""

NO_LIMITS = Limits(np.inf, np.inf, np.inf)
"""Where any residual is believed."""


def find_exclusions(whole: ResidualModel, q: Sequence[Array], seen: Sequence[Sequence[SeenCells]],
                    typical: Mapping[int, TypicalCell], limits: Limits, *, is_regularized: bool) -> Exclusions:
    """Find what of a frame does not show the specimen; collective.

    Parameters
    ----------
    whole : ResidualModel
        With all pixels that the frame shows.
    q : sequence of (n_unknowns,) array
        Unknowns of each owned subdomain.
    seen : sequence of sequence of SeenCells
        Cells of each subdomain and view.
    typical : mapping of int to TypicalCell
        By camera.
    limits : Limits
        From which error on a residual is not believed.
    is_regularized : bool
        Whether mechanics hold what pixels do not.

    Returns
    -------
    Exclusions
        Of owned subdomains.

    Raises
    ------
    ConvergenceError
        On all ranks, where most of the frame shows something else.
    """
    team = whole.team
    suspects = _find_standing_out(whole, seen, typical, limits.cell)
    shares = [[of_view.n_pixels.sum(), of_view.n_pixels[of_suspects].sum()]
              for of_subdomain, suspects_of in zip(seen, suspects, strict=True)
              for of_view, of_suspects in zip(of_subdomain, suspects_of, strict=True)]
    n_pixels, n_suspect = team.sum(np.sum(shares, axis=0) if shares else np.zeros(2))
    if limits is AT_START and n_suspect > START_SHARE * n_pixels:
        limits = NO_LIMITS
        suspects = _find_standing_out(whole, seen, typical, limits.cell)
    elif n_suspect > LARGEST_SHARE * n_pixels:
        raise as_collective(ConvergenceError(
            f"{n_suspect / n_pixels:.0%} of the pixels do not show in the deformed image what the field says: the "
            "start is wrong, or the images do not show the same surface; look at both, and give a start"))
    searched = _find_standing_out(whole, seen, typical, limits.searched)

    def find() -> Exclusions:
        found = [[_judge_view(view, q[number], seen[number][k], typical[view.camera],
                              _Judgement(limits.pixel, suspects[number][k], searched[number][k],
                                         whole.correction == "element", is_regularized))
                  for k, view in enumerate(of_subdomain.views)] for number, of_subdomain in enumerate(whole.views)]
        return Exclusions([tuple(states for states, _ in of_subdomain) for of_subdomain in found],
                          [tuple(spots for _, spots in of_subdomain) for of_subdomain in found])

    excluded = team.together(find)
    # Mechanics hold what a frame does not show; what it shows beside something else is another matter.
    doubted = (BLANK, SPOILT) if is_regularized else (BLANK, SPOILT, UNSEEN)
    n_doubted = sum(int(np.isin(state, doubted).any()) for of_subdomain in excluded.cells for state in of_subdomain)
    return exclude_weak_cells(whole, excluded) if team.sum(n_doubted) else excluded


def _find_standing_out(whole: ResidualModel, seen: Sequence[Sequence[SeenCells]], typical: Mapping[int, TypicalCell],
                       limit: float) -> list[list[NDArray[np.bool_]]]:
    """Cells whose residual is that of an error beyond a limit, pixels, by subdomain and view."""
    return [[_stands_out(of_view, typical[view.camera], limit)
             for view, of_view in zip(of_subdomain.views, of_views, strict=True)]
            for of_subdomain, of_views in zip(whole.views, seen, strict=True)]


def _stands_out(seen: SeenCells, typical: TypicalCell, limit: float) -> NDArray[np.bool_]:
    excess = seen.unexplained - typical.noise
    texture = np.maximum(seen.texture, max(WEAK_TEXTURE * typical.texture, 1e-300))
    n = np.maximum(seen.n_pixels, 1.0)
    # Wilson and Hilferty's bound of a sum of n squares: few pixels vary more than a normal distribution says.
    by_chance = (1.0 - 2.0 / (9.0 * n) + SIGNIFICANT * np.sqrt(2.0 / (9.0 * n)))**3
    like_speckle = typical.noise / max(typical.contrast, 1e-300)
    least = typical.noise * np.maximum(by_chance, LEAST_EXCESS + OF_CONTRAST * like_speckle)
    is_off = (excess > 0.5 * texture * limit**2) & (seen.unexplained > least)
    contrast = seen.spread_f**2
    expected = contrast / np.maximum(contrast + typical.noise, 1e-300)
    is_textured = seen.texture > BLANK_TEXTURE * typical.texture
    has_contrast = is_textured & (expected > CORRELATED) & (n >= FEWEST_PIXELS) & np.isfinite(limit)
    is_unlike = (seen.coefficient < SAME_SPECKLE * expected) & (seen.unexplained > UNEXPLAINED * seen.variance)
    is_other = has_contrast & is_unlike
    return np.asarray((is_off | is_other) & (seen.n_pixels > 0))


@dataclass(frozen=True, eq=False)
class _Judgement:
    """How the cells of a view are judged.

    limit : about a pixel; suspects, searched : (n_cells,) cells that stand out, and those that are searched for spoilt
    pixels; own_brightness : whether each cell has its own; is_regularized : whether mechanics hold cells.
    """

    limit: float
    suspects: NDArray[np.bool_]
    searched: NDArray[np.bool_]
    own_brightness: bool
    is_regularized: bool


def _judge_view(view: FrameView, q: Array, seen: SeenCells, typical: TypicalCell,
                judgement: _Judgement) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """States of a view's cells, and spoilt pixels of those that are kept."""
    states = np.full(len(seen.n_pixels), KEPT, dtype=np.uint8)
    # Where nothing has texture at all, the operators say so.
    is_weak = (seen.texture <= BLANK_TEXTURE * typical.texture) & (typical.texture > 0)
    states[is_weak & (seen.coefficient < CORRELATED) & (seen.n_pixels >= FEWEST_PIXELS)] = BLANK
    least = 0.0 if judgement.is_regularized else LEAST_SHOWN
    states[(seen.n_pixels == 0) | (seen.n_pixels < least * view.view.count_pixels())] = UNSEEN
    states[judgement.suspects & (states == KEPT)] = SPOILT
    searched = np.flatnonzero(judgement.searched & ((states == KEPT) | (states == SPOILT)))
    spots = [np.zeros((0, 2), dtype=np.int64)]
    if not len(searched):
        return states, spots[0]
    residual = view.compute_residual_image(q)
    # Of all, where cells have none of their own.
    for cell in searched.tolist():
        origin, patch = _cut_patch(view.view.correlation, residual, cell, (typical.gain, typical.offset))
        n_counted = int(patch.counts.sum())
        if n_counted < FEWEST_PIXELS:
            continue
        spoilt = find_spoilt_pixels(patch, typical.noise, judgement.limit, own_brightness=judgement.own_brightness)
        if not spoilt.any():
            continue
        is_most = spoilt.sum() > MOST_SPOILT * n_counted
        # A cell that does not stand out is as good as the field can follow it.
        states[cell] = SPOILT if is_most and judgement.suspects[cell] else KEPT
        if not is_most:
            rows, columns = np.nonzero(spoilt)
            spots.append(np.column_stack([columns + origin[0], rows + origin[1]]))
    return states, np.concatenate(spots)


def _cut_patch(correlation: Correlation, residual: NDArray[np.float32], cell: int,
               correction: tuple[float, float]) -> tuple[tuple[int, int], CellPatch]:
    """The box about a cell's pixels: its first column and row, and what is in it."""
    raster, image = correlation.raster, correlation.reference
    runs = slice(raster.row_ptr[cell], raster.row_ptr[cell + 1])
    # Rows at a tip may hold no pixel's centre, and lie beyond the window then.
    filled = np.flatnonzero(raster.stops[runs] > raster.starts[runs])
    starts, stops = (ends[runs][filled[0]:filled[-1] + 1] for ends in (raster.starts, raster.stops))
    is_filled = stops > starts
    x0, x1 = int(starts[is_filled].min()), int(stops[is_filled].max())
    y0 = int(raster.first_row[cell] + filled[0])
    columns = np.arange(x0, x1)
    own = (columns >= starts[:, None]) & (columns < stops[:, None])
    box = (slice(y0 - image.window.y0, y0 - image.window.y0 + len(starts)),
           slice(x0 - image.window.x0, x1 - image.window.x0))
    r = residual[box].astype(np.float64)
    counts = own & np.isfinite(r)
    f = image.values[box].astype(np.float64)
    gain, offset = correction
    g = np.where(counts, gain * (f - r) + offset, 0.0)
    energy = image.by_x[box].astype(np.float64)**2 + image.by_y[box].astype(np.float64)**2
    return (x0, y0), CellPatch(counts, f, g, energy)
