"""Whether a pair needs its grey levels corrected: nothing, the whole image, or every cell by itself."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.grey_statistics import GreyCorrection
from ddic.functionals.weighted_median import find_weighted_median
from ddic.problem.seen_cells import SeenCells, TypicalCell, find_typical_cell

Array = NDArray[np.float64]

GLOBAL_SHARE = 0.02
"""Mean square of a brightness change of the whole image, relative to the residual's variance, from which on it is
corrected. A larger share leaves as much of it in the residual, where it counts like noise."""

CELL_SHARE = 0.1
"""The same of what differs from cell to cell: a correction of each cell costs some of its information."""

GROSS = 4.0
"""Brightness change of a cell, squared and relative to the residual's variance, from which on it is gross."""

GROSS_SHARE = 0.005
"""Share of the pixels in cells of gross changes, a reflection say, from which on cells are corrected one by one."""

FEWEST_PIXELS = 64
"""Pixels of a cell, in the median, from which on it can tell its own gain and offset from a displacement."""

LEAST_CHANGE, LEAST_GROSS = 0.005, 0.02
"""Brightness change relative to the contrast of the speckle below which it is none, and not gross: images without noise
are no reason to correct what interpolation leaves."""

ORDER: tuple[GreyCorrection, ...] = ("none", "global", "element")
"""From the simplest on."""


def choose_correction(cells: Mapping[int, SeenCells], least: GreyCorrection = "none",
                      most: GreyCorrection = "element") -> GreyCorrection:
    """Choose the simplest correction of grey levels that leaves no more than noise.

    Means and standard deviations are compared, which a displacement that is still wrong hardly changes, and medians
    over cells, which a hidden part does not change.

    Parameters
    ----------
    cells : mapping of int to SeenCells
        By camera.
    least, most : GreyCorrection
        What was chosen before, never less than which is, and the most that can be.

    Returns
    -------
    GreyCorrection
        One for all cameras.
    """
    wanted = [_choose(of_camera) for of_camera in cells.values() if len(of_camera.n_pixels)]
    chosen = max([least, *wanted], key=ORDER.index)
    return min(chosen, most, key=ORDER.index)


def _choose(cells: SeenCells) -> GreyCorrection:
    typical = find_typical_cell(cells)
    n = cells.n_pixels
    change_of_mean = find_weighted_median(cells.mean_f - cells.mean_g, n)
    change_of_spread = find_weighted_median(cells.spread_f - cells.spread_g, n)
    least = max(GLOBAL_SHARE * typical.noise, LEAST_CHANGE**2 * typical.contrast)
    is_whole = change_of_mean**2 + change_of_spread**2 > least
    correction = (typical.gain, typical.offset) if is_whole else (1.0, 0.0)
    if np.median(n) >= FEWEST_PIXELS and _differ(cells, correction, typical):
        return "element"
    return "global" if is_whole else "none"


def _differ(cells: SeenCells, correction: tuple[float, float], typical: TypicalCell) -> bool:
    """Whether the brightness changes otherwise in some cells than in most."""
    noise, (gain, offset) = typical.noise, correction
    squared = ((cells.mean_f - gain * cells.mean_g - offset)**2
               + (cells.spread_f - gain * cells.spread_g)**2)
    # What is hidden, or not found yet, is not explained by brightness.
    is_explained = cells.variance <= GROSS * noise
    n = cells.n_pixels
    is_gross = is_explained & (squared > max(GROSS * noise, LEAST_GROSS**2 * typical.contrast))
    if n[is_gross].sum() > GROSS_SHARE * n.sum():
        return True
    mean_square = float((n * squared)[is_explained].sum() / max(n[is_explained].sum(), 1.0))
    return mean_square > max(CELL_SHARE * noise, LEAST_CHANGE**2 * typical.contrast)
