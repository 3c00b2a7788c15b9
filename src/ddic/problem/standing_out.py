"""Cells that stand out: their residual is more than noise and a small error of the displacement explain."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.problem.seen_cells import FEWEST_PIXELS, SeenCells, TypicalCell

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
"""Correlation coefficient of f and g from which on a cell of weak texture is seen nevertheless: noise of 400 pixels has
one of 0.05."""

TINY = 1e-300
"""What keeps quotients finite."""


def find_standing_out(seen: SeenCells, typical: TypicalCell, limit: float) -> NDArray[np.bool_]:
    """Find the cells that stand out.

    Parameters
    ----------
    seen : SeenCells
        Of a view.
    typical : TypicalCell
        Of its camera.
    limit : float
        Error of the displacement whose residual is believed, pixels; inf where any residual is.

    Returns
    -------
    (n_cells,) array of bool
        Those that show pixels and stand out.
    """
    is_off = _find_off(seen, typical, limit)
    if np.isfinite(limit):
        is_off |= _find_other_speckle(seen, typical)
    return np.asarray(is_off & (seen.n_pixels > 0))


def _find_off(seen: SeenCells, typical: TypicalCell, limit: float) -> NDArray[np.bool_]:
    """Cells with the residual of a larger error of the displacement, beyond chance."""
    texture = np.maximum(seen.texture, max(WEAK_TEXTURE * typical.texture, TINY))
    # What an error leaves: |grad f|^2 error^2, halved since the error has any direction.
    is_large = seen.unexplained - typical.noise > 0.5 * texture * limit**2
    n = np.maximum(seen.n_pixels, 1.0)
    # Wilson and Hilferty's bound of a sum of n squares: few pixels vary more than a normal distribution says.
    by_chance = (1.0 - 2.0 / (9.0 * n) + SIGNIFICANT * np.sqrt(2.0 / (9.0 * n)))**3
    like_speckle = typical.noise / max(typical.contrast, TINY)
    least = typical.noise * np.maximum(by_chance, LEAST_EXCESS + OF_CONTRAST * like_speckle)
    return np.asarray(is_large & (seen.unexplained > least))


def _find_other_speckle(seen: SeenCells, typical: TypicalCell) -> NDArray[np.bool_]:
    """Cells of enough contrast whose grey levels in both images are not alike."""
    contrast = seen.spread_f**2
    # Correlation coefficient of two images of the same speckle with noise.
    expected = contrast / np.maximum(contrast + typical.noise, TINY)
    is_textured = seen.texture > BLANK_TEXTURE * typical.texture
    has_contrast = is_textured & (expected > CORRELATED) & (seen.n_pixels >= FEWEST_PIXELS)
    is_unlike = (seen.coefficient < SAME_SPECKLE * expected) & (seen.unexplained > UNEXPLAINED * seen.variance)
    return np.asarray(has_contrast & is_unlike)
