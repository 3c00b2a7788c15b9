"""Pixels of a cell whose residual neither noise nor brightness nor a displacement explains.

A displacement that is wrong by e leaves a residual of mean square |grad f|^2 e^2 / dim. Where the residual about a
pixel is that of more than a limit, something else is seen there: dirt, a reflection, what lies in front of the
specimen.

Boxes of pixels about cells, cut out of both images.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from ddic.arrays import Array, BoolArray, IntArray
from ddic.functionals.correlation import Correlation, RowBand
from ddic.functionals.view import FrameView
from ddic.images.volume import find_slopes
from ddic.images.window import Window
from ddic.mesh.raster import list_pixels

ABOUT = {2: 5, 3: 3}
"""Side, pixels, of the square, or cube, about a pixel over which the residual is averaged: single pixels of what hides
the specimen may be as bright as it. A larger one finds weaker spots and loses more pixels about them."""

BEYOND_NOISE = 4.0
"""Mean square of the residual about a pixel, relative to the noise's variance, from which on noise does not explain it:
that of 25 pixels is known to a third."""

MARGIN = 2
"""Pixels about a spoilt one that are left out too: edges of spots are blurred by lens and interpolation."""

WEAK_SHARE = 0.3
"""Share of the cell's mean |grad f|^2 that a pixel's surroundings are given at least."""

FIT_ROUNDS = 4
"""Times that gain and offset of a cell are fitted to the pixels that agree with them best."""

KEPT_SHARE = 0.5
"""Share of a cell's pixels to which they are fitted."""

FLAT = 0.1
"""Variance of g on these pixels, relative to that of f on all of the cell, below which they show no speckle."""


@dataclass(frozen=True, eq=False)
class CellPatch:
    """The box of pixels about a cell.

    Attributes
    ----------
    counts : bool array of the box's shape
        The cell's own pixels, where both images show them.
    f, g : array of the box's shape
        Grey levels, g displaced and corrected; anything where a pixel does not count.
    energy : array of the box's shape
        |grad f|^2, (grey levels / px)^2.
    """

    counts: BoolArray
    f: Array
    g: Array
    energy: Array


def find_spoilt_pixels(patch: CellPatch, noise: float, limit: float, *, own_brightness: bool) -> BoolArray:
    """Find the spoilt pixels of a cell, and those close to them; none beside the cell.

    True there, an array of the box's shape. ``noise`` is the variance of the residual where nothing is spoilt, grey
    levels squared, ``limit`` the largest error of the displacement, pixels; ``own_brightness`` gives the cell a gain
    and an offset of its own.
    """
    if not patch.counts.any():
        return np.zeros(patch.counts.shape, dtype=bool)
    fitted = _fit_brightness(patch) if own_brightness else (1.0, 0.0)
    if fitted is None:
        return patch.counts.copy()
    gain, offset = fitted
    squared = np.where(patch.counts, (patch.f - gain * patch.g - offset)**2, 0.0)
    energy = np.where(patch.counts, patch.energy, 0.0)
    n = np.maximum(_add_about(patch.counts.astype(float)), 1.0)
    residual = _add_about(squared) / n
    weak = WEAK_SHARE * float(energy.sum()) / float(patch.counts.sum())
    texture = np.maximum(_add_about(energy) / n, max(weak, 1e-300))
    is_off = residual - noise > texture * limit**2 / patch.counts.ndim
    return _spread((residual > BEYOND_NOISE * noise) & is_off & patch.counts) & patch.counts


def _add_about(values: Array) -> Array:
    """Sums over the square, or cube, about each pixel; nothing beyond the edge."""
    side = ABOUT[values.ndim]
    if values.ndim == 3:
        return np.asarray(scipy.ndimage.convolve(values, np.ones((side,) * 3), mode="constant"))
    return np.asarray(cv2.boxFilter(values, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT))


def _spread(spoilt: BoolArray) -> BoolArray:
    """Add the pixels about the spoilt ones."""
    reach = 2 * MARGIN + 1
    if spoilt.ndim == 3:
        return np.asarray(scipy.ndimage.binary_dilation(spoilt, np.ones((reach,) * 3)))
    return np.asarray(cv2.dilate(spoilt.astype(np.uint8), np.ones((reach, reach), np.uint8)) > 0)


def _fit_brightness(patch: CellPatch) -> tuple[float, float] | None:
    """Gain and offset of the pixels that agree best, least trimmed squares; None where these show no speckle."""
    f, g = patch.f[patch.counts], patch.g[patch.counts]
    gain, offset = 1.0, float(np.median(f - g))
    n_kept = max(int(KEPT_SHARE * len(f)), 2)
    for _ in range(FIT_ROUNDS):
        best = np.argpartition(np.abs(f - gain * g - offset), n_kept - 1)[:n_kept]
        spread = float(g[best].var())
        if spread <= FLAT * float(f.var()):
            return None
        gain = float(np.cov(f[best], g[best], bias=True)[0, 1]) / spread
        offset = float(np.mean(f[best] - gain * g[best]))
    return gain, offset


def cut_patches(view: FrameView, q: Array, cells: IntArray,
                correction: tuple[float, float]) -> Iterator[tuple[int, Window, CellPatch]]:
    """Cut out the boxes about the pixels of some cells; the residual of no other pixel is computed.

    Gives the number of each cell, where its box lies in the image, and what is in it. ``q`` are the subdomain's
    unknowns; the cells, given by number, hold pixels; ``correction`` is gain and offset of g, no unit and grey levels.
    """
    correlation = view.correlation
    boxes = [_find_own_pixels(correlation, cell) for cell in cells.tolist()]
    bands = [RowBand(cells[k:k + 1], box) for k, (box, _) in enumerate(boxes)]
    residuals = view.compute_residual_bands(q, bands) if bands else iter(())
    for cell, (box, own), residual in zip(cells.tolist(), boxes, residuals, strict=True):
        yield cell, box, _cut_patch(correlation, (box, own), residual, correction)


def _cut_patch(correlation: Correlation, place: tuple[Window, BoolArray], residual: NDArray[np.float32],
               correction: tuple[float, float]) -> CellPatch:
    """What is in a box, of which some pixels are the cell's; residual: f - g there, NaN on what does not count."""
    box, own = place
    image = correlation.reference.restrict(box)
    r, f = residual.astype(np.float64), image.grey_levels.astype(np.float64)
    counts = own & np.isfinite(r)
    gain, offset = correction
    g = np.where(counts, gain * (f - r) + offset, 0.0)
    return CellPatch(counts, f, g, (find_slopes(image)**2).sum(axis=0))


def _find_own_pixels(correlation: Correlation, cell: int) -> tuple[Window, BoolArray]:
    """The box about a cell's pixels, and which of those in the box are the cell's."""
    pixels, _ = list_pixels(correlation.raster, np.array([cell]))
    box = Window.between(pixels.min(axis=0), pixels.max(axis=0) + 1)
    own = np.zeros(box.shape, dtype=bool)
    own[box.index(pixels)] = True
    return box, own
