"""How steep the reference image is in each cell."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np
from numpy.typing import NDArray

from ddic.images.spline import GradientImage
from ddic.mesh.raster import Raster

FLAT = 1e-6
"""Slope across speckle that varies in one direction only, squared, relative to that along: rounding."""


@dataclass(frozen=True, eq=False)
class CellSlopes:
    """Mean of grad f grad f^T over the pixels of cells.

    Attributes
    ----------
    mean : (n_cells, 2, 2) array
        (Grey levels / px)^2; 0 without pixels.
    """

    mean: NDArray[np.float64]

    @cached_property
    def inverse(self) -> NDArray[np.float64]:
        """Pseudo-inverse of each mean, (n_cells, 2, 2): a translation along lines of equal grey is not seen."""
        return np.asarray(np.linalg.pinv(self.mean, rcond=FLAT, hermitian=True))

    @cached_property
    def texture(self) -> NDArray[np.float64]:
        """Mean of |grad f|^2, (n_cells,)."""
        return np.asarray(np.trace(self.mean, axis1=1, axis2=2))


def measure_cell_slopes(raster: Raster, reference: GradientImage, n_pixels: NDArray[np.int64]) -> CellSlopes:
    """Measure the mean of grad f grad f^T over the pixels of each cell that count.

    Parameters
    ----------
    raster : Raster
        Every cell's pixels.
    reference : GradientImage
        f and grad f on a window that holds them.
    n_pixels : (n_cells,) array of int64
        How many count.

    Returns
    -------
    CellSlopes
        Of every cell.
    """
    # A kernel takes one type: an image without pixels stands for one that excludes none.
    usable = np.ones((0, 0), np.uint8) if reference.usable is None else reference.usable
    sums = np.zeros((len(n_pixels), 3))
    # Windows into larger ones are copied: their layout is another type.
    by_x, by_y = np.ascontiguousarray(reference.by_x), np.ascontiguousarray(reference.by_y)
    _add_up_slopes(by_x, by_y, np.ascontiguousarray(usable), reference.window.x0, reference.window.y0, raster.first_row,
                   raster.row_ptr, raster.starts, raster.stops, sums)
    xx, xy, yy = (sums / np.maximum(n_pixels, 1)[:, None]).T
    return CellSlopes(np.stack([xx, xy, xy, yy], axis=1).reshape(-1, 2, 2))


@numba.njit(cache=True, nogil=True)
def _add_up_slopes(by_x, by_y, usable, x0, y0, first_row, row_ptr, starts, stops,  # type: ignore[no-untyped-def]
                   sums):
    """Add up f_x^2, f_x f_y and f_y^2 over each cell's pixels."""
    all_count = usable.size == 0
    for e in range(len(first_row)):
        top = first_row[e] - y0 - row_ptr[e]
        xx = xy = yy = 0.0
        for r in range(row_ptr[e], row_ptr[e + 1]):
            for x in range(starts[r] - x0, stops[r] - x0):
                if all_count or usable[top + r, x]:
                    # In double precision, as the sums are.
                    slope_x, slope_y = 1.0 * by_x[top + r, x], 1.0 * by_y[top + r, x]
                    xx += slope_x * slope_x
                    xy += slope_x * slope_y
                    yy += slope_y * slope_y
        sums[e, 0], sums[e, 1], sums[e, 2] = xx, xy, yy
