"""Boxes of pixels about cells, cut out of both images."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.correlation import Band, Correlation
from ddic.functionals.spoilt_pixels import CellPatch
from ddic.functionals.view import FrameView
from ddic.images.window import Window


def cut_patches(view: FrameView, q: NDArray[np.float64], cells: NDArray[np.int64],
                correction: tuple[float, float]) -> Iterator[tuple[int, Window, CellPatch]]:
    """Cut out the boxes about the pixels of some cells; the residual of no other pixel is computed.

    Parameters
    ----------
    view : FrameView
        Both images, and the cells' pixels.
    q : (n_unknowns,) array
        The subdomain's unknowns.
    cells : (n,) int64 array
        Their numbers; they hold pixels.
    correction : (gain, offset)
        Of g, no unit and grey levels.

    Returns
    -------
    iterator of (int, Window, CellPatch)
        Number of each cell, where its box lies in the image, and what is in it.
    """
    correlation = view.view.correlation
    boxes = [_find_own_pixels(correlation, cell) for cell in cells.tolist()]
    bands = [Band(cells[k:k + 1], box) for k, (box, _) in enumerate(boxes)]
    residuals = view.compute_residual_bands(q, bands) if bands else iter(())
    for cell, (box, own), residual in zip(cells.tolist(), boxes, residuals, strict=True):
        yield cell, box, _cut_patch(correlation, (box, own), residual, correction)


def _cut_patch(correlation: Correlation, place: tuple[Window, NDArray[np.bool_]], residual: NDArray[np.float32],
               correction: tuple[float, float]) -> CellPatch:
    """What is in a box, of which some pixels are the cell's; residual: f - g there, NaN on what does not count."""
    box, own = place
    image = correlation.reference.restrict(box)
    r, f = residual.astype(np.float64), image.values.astype(np.float64)
    counts = own & np.isfinite(r)
    gain, offset = correction
    g = np.where(counts, gain * (f - r) + offset, 0.0)
    return CellPatch(counts, f, g, image.by_x.astype(np.float64)**2 + image.by_y.astype(np.float64)**2)


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
