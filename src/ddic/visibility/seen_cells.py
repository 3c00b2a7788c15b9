"""What a frame shows of cells: grey levels, residual, what most cells are like, and which stand out from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from ddic.arrays import Array, BoolArray
from ddic.functionals.correlation import Residual
from ddic.functionals.grey_statistics import find_flat
from ddic.functionals.view import CellSlopes, FrameView
from ddic.parallel.distribution import find_quantile_of_all
from ddic.parallel.field import ByView
from ddic.parallel.team import Team
from ddic.problem.residual_model import Evaluation, ResidualModel

FEWEST_PIXELS = 36
"""Pixels of a cell from which on a gain, an offset and single spoilt pixels can be told in it."""

ENOUGH_CELLS = 20_000
"""Cells of the region of which medians are taken, evenly spread over their numbers: these are known to a per cent."""

MOST_NOISE = 0.3
"""Variance of the residual, relative to the contrast of the speckle, up to which it is noise. A larger value takes
unlike images for noisy ones, a smaller one noisy images for unlike ones."""

TEXTURED = 0.9
"""Share of the pixels in cells of weaker texture than what is called textured: most of the region may be blank."""

SIGNIFICANT = 6.0
"""Standard deviations beyond which noise alone does not make a cell stand out: it does in one of 10^9."""

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
"""Correlation coefficient of f and g from which on a cell of weak texture is seen nevertheless, and below whose
negative contrast is inverted: noise of 400 pixels has one of 0.05."""

TINY = 1e-300
"""What keeps quotients finite."""


@dataclass(frozen=True, eq=False)
class SeenCells:
    """Cells of a view in a frame; all (n_cells,).

    Attributes
    ----------
    n_pixels : array
        That count.
    variance : array
        Of the residual, with a gain and an offset of the cell's own where its pixels tell them, grey levels squared.
    unexplained : array
        The same without what a translation of the cell would explain: a field that mechanics hold back, say.
    texture : array
        Mean of |grad f|^2, (grey levels / px)^2.
    mean_f, mean_g : array
        Grey levels.
    spread_f, spread_g : array
        Standard deviations, grey levels; that of g is negative where its dark and bright have changed places.
    coefficient : array
        Correlation coefficient of f and g(x + u), 0 where either is flat; without its sign where gains are fitted,
        which may be negative.
    """

    n_pixels: Array
    variance: Array
    unexplained: Array
    texture: Array
    mean_f: Array
    mean_g: Array
    spread_f: Array
    spread_g: Array
    coefficient: Array

    def choose(self, chosen: BoolArray) -> SeenCells:
        """Choose some of the cells."""
        return SeenCells(*(getattr(self, field.name)[chosen] for field in fields(self)))


@dataclass(frozen=True)
class TypicalCell:
    """What most cells of a camera are like, by pixels.

    Attributes
    ----------
    noise, contrast : float
        Median variances of the residual that a translation does not explain, and of f, grey levels squared.
    texture : float
        Mean of |grad f|^2 of textured cells, (grey levels / px)^2.
    gain, offset : float
        Medians of f = gain g + offset; no unit, and grey levels.
    """

    noise: float
    contrast: float
    texture: float
    gain: float
    offset: float

    @property
    def is_alike(self) -> bool:
        """Whether most cells look alike in both images, so that what is left of their residual is noise."""
        return self.noise <= MOST_NOISE * self.contrast


def measure_seen_cells(whole: ResidualModel, evaluation: Evaluation, slopes: ByView[CellSlopes]) -> ByView[SeenCells]:
    """Measure the cells of owned subdomains in a frame; free of communication."""

    def measure(view: FrameView, residual: Residual, of_view: CellSlopes) -> SeenCells:
        cells = _measure(residual, of_view, whole.find_correction(evaluation, view.camera, residual))
        return cells if whole.correction == "none" else replace(cells, coefficient=np.abs(cells.coefficient))

    return whole.views.map(measure, evaluation.residuals, slopes)


def _measure(residual: Residual, slopes: CellSlopes, correction: tuple[Array, Array]) -> SeenCells:
    sums = residual.cell_sums
    n = sums.n_pixels
    safe = np.maximum(n, 1.0)
    _, of_own = sums.sum_residual(*sums.fit_gain_and_offset())
    _, of_used = sums.sum_residual(*correction)
    variance = np.where(n >= FEWEST_PIXELS, of_own, of_used) / safe
    _, r, g, rr, gg, rg = np.moveaxis(sums.values, -1, 0)
    mean_f, mean_g = (r + g) / safe, g / safe
    square_f, square_g = (rr + 2 * rg + gg) / safe, gg / safe
    variance_f, variance_g = square_f - mean_f**2, square_g - mean_g**2
    spread_f, spread_g = np.sqrt(np.maximum(variance_f, 0.0)), np.sqrt(np.maximum(variance_g, 0.0))
    covariance = (rg + gg) / safe - mean_f * mean_g
    # Where nothing varies, nothing but rounding correlates.
    is_flat = find_flat(variance_f, square_f) | find_flat(variance_g, square_g)
    coefficient = np.where(is_flat, 0.0, covariance / np.maximum(spread_f * spread_g, TINY))
    spread_g = np.where(coefficient < -CORRELATED, -spread_g, spread_g)
    unexplained = np.maximum(variance - _explain(residual, slopes, correction), 0.0)
    return SeenCells(n, variance, unexplained, slopes.texture, mean_f, mean_g, spread_f, spread_g, coefficient)


def _explain(residual: Residual, slopes: CellSlopes, correction: tuple[Array, Array]) -> Array:
    """Mean square of a cell's residual that a small translation of it explains, (n_cells,), grey levels squared."""
    safe = np.maximum(residual.cell_sums.n_pixels, 1.0)[:, None]
    b = residual.correct_moments(*correction)[..., 0] / safe
    translation = np.einsum("cij,cj->ci", slopes.inverse, b)
    return np.asarray(np.einsum("ci,ci->c", b, translation))


def choose_sample(whole: ResidualModel, seen: ByView[SeenCells]) -> dict[int, SeenCells]:
    """Choose from this rank's cells with pixels, by camera, not more than medians of all ranks' need; collective.

    All ranks' together are the same on any number of ranks.
    """
    subdomains = whole.subdomains
    n_cells = whole.team.sum(sum(subdomain.mesh.n_cells for subdomain in subdomains))
    step = max(1, int(n_cells) // ENOUGH_CELLS)
    are_sampled = whole.views.fill([subdomain.cell_ids % step == 0 for subdomain in subdomains])
    chosen = seen.map(lambda cells, is_sampled: cells.choose(is_sampled & (cells.n_pixels > 0)), are_sampled)
    none = SeenCells(*(np.empty(0) for _ in fields(SeenCells)))
    by_camera = {camera: [none] for camera in range(whole.n_cameras)}
    for view, cells in zip(whole.views.flat, chosen.flat, strict=True):
        by_camera[view.camera].append(cells)
    return {camera: _join(parts) for camera, parts in by_camera.items()}


def _join(parts: Sequence[SeenCells]) -> SeenCells:
    return SeenCells(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(SeenCells)))


def find_typical_cell(team: Team, cells: SeenCells) -> TypicalCell:
    """Find what most of all ranks' cells with pixels are like, zeros if there are none; collective."""
    n, varies = cells.n_pixels, cells.spread_g != 0

    def find(values: Array, share: float = 0.5) -> float:
        return find_quantile_of_all(team, values, n, share) or 0.0

    gain = find_quantile_of_all(team, cells.spread_f[varies] / cells.spread_g[varies], n[varies])
    # Where nothing varies, nothing tells it.
    gain = 1.0 if gain is None else gain
    offset = find(cells.mean_f - gain * cells.mean_g)
    return TypicalCell(find(cells.unexplained), find(cells.spread_f)**2, find(cells.texture, TEXTURED), gain, offset)


def see_cells(whole: ResidualModel, evaluation: Evaluation, slopes: ByView[CellSlopes],
              ) -> tuple[ByView[SeenCells], dict[int, SeenCells], dict[int, TypicalCell]]:
    """Measure the cells of owned subdomains; with a sample of them, and what most of all ranks' are like, by camera."""
    seen = measure_seen_cells(whole, evaluation, slopes)
    sample = choose_sample(whole, seen)
    return seen, sample, {camera: find_typical_cell(whole.team, cells) for camera, cells in sample.items()}


def find_blank(cells: SeenCells, typical: TypicalCell) -> BoolArray:
    """Find the cells of a view that have no texture, (n_cells,); none where nothing has any: the operators say so."""
    is_weak = (cells.texture <= BLANK_TEXTURE * typical.texture) & (typical.texture > 0)
    return np.asarray(is_weak & (cells.coefficient < CORRELATED) & (cells.n_pixels >= FEWEST_PIXELS))


def find_standing_out(seen: SeenCells, typical: TypicalCell, limit: float, dim: int) -> BoolArray:
    """Find the cells of a view that show pixels and stand out, (n_cells,).

    ``limit`` is the error of the displacement whose residual is believed, pixels; inf where any residual is.
    """
    is_off = _find_off(seen, typical, limit, dim)
    if np.isfinite(limit):
        is_off |= _find_other_speckle(seen, typical)
    return np.asarray(is_off & (seen.n_pixels > 0))


def _find_off(seen: SeenCells, typical: TypicalCell, limit: float, dim: int) -> BoolArray:
    """Cells with the residual of a larger error of the displacement, beyond chance."""
    texture = np.maximum(seen.texture, max(WEAK_TEXTURE * typical.texture, TINY))
    # What an error of any direction leaves.
    is_large = seen.unexplained - typical.noise > texture * limit**2 / dim
    n = np.maximum(seen.n_pixels, 1.0)
    # Wilson and Hilferty's bound of a sum of n squares: few pixels vary more than a normal distribution says.
    by_chance = (1.0 - 2.0 / (9.0 * n) + SIGNIFICANT * np.sqrt(2.0 / (9.0 * n)))**3
    like_speckle = typical.noise / max(typical.contrast, TINY)
    least = typical.noise * np.maximum(by_chance, LEAST_EXCESS + OF_CONTRAST * like_speckle)
    return np.asarray(is_large & (seen.unexplained > least))


def _find_other_speckle(seen: SeenCells, typical: TypicalCell) -> BoolArray:
    """Cells of enough contrast whose grey levels in both images are not alike."""
    contrast = seen.spread_f**2
    # Correlation coefficient of two images of the same speckle with noise.
    expected = contrast / np.maximum(contrast + typical.noise, TINY)
    is_textured = seen.texture > BLANK_TEXTURE * typical.texture
    has_contrast = is_textured & (expected > CORRELATED) & (seen.n_pixels >= FEWEST_PIXELS)
    is_unlike = (seen.coefficient < SAME_SPECKLE * expected) & (seen.unexplained > UNEXPLAINED * seen.variance)
    return np.asarray(has_contrast & is_unlike)
