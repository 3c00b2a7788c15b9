"""The box of pixels about a cell, cut out of both images."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.correlation import Correlation
from ddic.functionals.spoilt_pixels import CellPatch
from ddic.images.window import Window


def cut_patch(correlation: Correlation, residual: NDArray[np.float32], cell: int,
              correction: tuple[float, float]) -> tuple[Window, CellPatch]:
    """Cut out the box about a cell's pixels.

    Parameters
    ----------
    correlation : Correlation
        The reference image, and the cell's pixels.
    residual : (height, width) array
        f - g on the reference window, grey levels; NaN on pixels that do not count.
    cell : int
        Its number; it holds pixels.
    correction : (gain, offset)
        Of g, no unit and grey levels.

    Returns
    -------
    box : Window
        Where the box lies in the image.
    patch : CellPatch
        What is in it.
    """
    box, own = _find_own_pixels(correlation, cell)
    image = correlation.reference
    inside = image.window.locate(box)
    r = residual[inside].astype(np.float64)
    f = image.values[inside].astype(np.float64)
    counts = own & np.isfinite(r)
    gain, offset = correction
    g = np.where(counts, gain * (f - r) + offset, 0.0)
    energy = image.by_x[inside].astype(np.float64)**2 + image.by_y[inside].astype(np.float64)**2
    return box, CellPatch(counts, f, g, energy)


def _find_own_pixels(correlation: Correlation, cell: int) -> tuple[Window, NDArray[np.bool_]]:
    """The box about a cell's pixels, and which of those in the box are the cell's."""
    raster = correlation.raster
    runs = slice(raster.row_ptr[cell], raster.row_ptr[cell + 1])
    # Rows at a tip may hold no pixel's centre, and lie beyond the window then.
    filled = np.flatnonzero(raster.stops[runs] > raster.starts[runs])
    starts, stops = (ends[runs][filled[0]:filled[-1] + 1] for ends in (raster.starts, raster.stops))
    is_filled = stops > starts
    x0, x1 = int(starts[is_filled].min()), int(stops[is_filled].max())
    y0 = int(raster.first_row[cell] + filled[0])
    columns = np.arange(x0, x1)
    own = (columns >= starts[:, None]) & (columns < stops[:, None])
    return Window(x0, y0, x1, y0 + len(starts)), own
