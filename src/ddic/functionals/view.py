"""What one camera says about a subdomain: M and b, Eq. 7 of [BP17], in its unknowns; slopes of f in each cell."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.arrays import Array, BoolArray, IntArray
from ddic.functionals.correlation import Correlation, Residual, RowBand
from ddic.images.spline import GradientImage
from ddic.images.sub_image import DeformedSubImage
from ddic.images.window import Window
from ddic.kinematics.kinematics import Kinematics
from ddic.mesh.raster import Raster

FLAT = 1e-6
"""Slope across speckle that varies in one direction only, squared, relative to that along: rounding."""


@dataclass(frozen=True, eq=False)
class CellSlopes:
    """Mean of grad f grad f^T over the pixels of cells.

    Attributes
    ----------
    mean : (n_cells, dim, dim) array
        (Grey levels / px)^2; 0 without pixels.
    """

    mean: Array

    @cached_property
    def inverse(self) -> Array:
        """Pseudo-inverse of each mean, (n_cells, dim, dim): a translation along lines of equal grey is not seen."""
        return np.asarray(np.linalg.pinv(self.mean, rcond=FLAT, hermitian=True))

    @cached_property
    def texture(self) -> Array:
        """Mean of |grad f|^2, (n_cells,)."""
        return np.asarray(np.trace(self.mean, axis1=1, axis2=2))


def _measure_cell_slopes(raster: Raster, reference: GradientImage, n_pixels: IntArray) -> CellSlopes:
    """Measure the mean of grad f grad f^T over the pixels of each cell that count, ``n_pixels`` of them, (n_cells,)."""
    # A kernel takes one type: an image without pixels stands for one that excludes none.
    usable = np.ones((0, 0), np.uint8) if reference.usable is None else reference.usable
    sums = np.zeros((len(n_pixels), 3))
    # Windows into larger ones are copied: their layout is another type.
    by_x, by_y = map(np.ascontiguousarray, reference.slopes)
    _add_up_slopes(by_x, by_y, np.ascontiguousarray(usable), reference.window.x0, reference.window.y0,
                   raster.first_rows[:, 0], raster.row_ptr, raster.starts, raster.stops, sums)
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


Correction = Array | float
"""Gain or offset of the grey levels: one number, or one per cell (n_cells,)."""


@dataclass(frozen=True)
class View:
    """A camera's pixels of a subdomain in the reference image.

    Attributes
    ----------
    correlation : Correlation
        Reference image on the mesh in the camera's pixels.
    kinematics : Kinematics
        From the subdomain's unknowns to displacements in the camera's pixels.
    camera : int
        Number of the camera, 0 the first.
    group : int
        Number of the window that the view looks into, among those of its camera on this rank.
    weight : float
        Of this camera's squared grey levels in the functional, no unit.
    """

    correlation: Correlation
    kinematics: Kinematics
    camera: int = 0
    group: int = 0
    weight: float = 1.0

    @property
    def n_pixels(self) -> int:
        """Number of pixels that the reference image does not exclude."""
        return self.correlation.n_usable_pixels

    def count_pixels(self) -> IntArray:
        """Count the pixels of each cell that the reference image does not exclude, (n_cells,)."""
        return self.correlation.count_pixels()

    def measure_slopes(self) -> CellSlopes:
        """Measure the mean of grad f grad f^T over the pixels of each cell that count."""
        if self.correlation.mesh.dim == 3:
            unturned = replace(self.correlation, inverse_deformations=None)
            return CellSlopes(unturned.sum_slopes() / np.maximum(self.count_pixels(), 1)[:, None, None])
        return _measure_cell_slopes(self.correlation.raster, self.correlation.reference, self.count_pixels())

    def measure_grey_range(self) -> tuple[float, float]:
        """Measure the range of the reference image's grey levels on the window that holds the view."""
        values = self.correlation.reference.grey_levels
        return float(values.min()), float(values.max())

    def assemble_hessian(self, cells: IntArray | None = None) -> sparse.csr_matrix:
        """Assemble M of this camera on displacements of nodes in its image, Eq. 7 of [BP17].

        Over the pixels of some cells, given by number, by default of all; grey levels squared per pixel squared.
        """
        return self.correlation.assemble_hessian(cells)

    def project(self, hessian: sparse.csr_matrix) -> sparse.csr_matrix:
        """Take M of this camera to the subdomain's unknowns, w T^T M T, its part of M_s."""
        projected = self.kinematics.project_matrix(hessian)
        return projected if self.weight == 1.0 else (self.weight * projected).tocsr()

    def with_moved_gradient(self, q: Array) -> Self:
        """Take the gradient of the deformed image where unknowns put it, in M and in b."""
        return replace(self, correlation=self.correlation.with_moved_gradient(self.kinematics.displacement(q)))

    def confine(self, cells: BoolArray) -> Self:
        """Confine passes over the pixels to some cells, (n_cells,)."""
        return replace(self, correlation=self.correlation.confine(cells))

    def hold_still(self) -> Self:
        """Give the same for a set-up that does not move, with weight 1: with the field's unknowns only."""
        return replace(self, kinematics=self.kinematics.hold_still(), weight=1.0)

    def open_frame(self, deformed: DeformedSubImage) -> FrameView:
        """Look at a frame, whose window is read when unknowns say where."""
        return FrameView(self.correlation, self.kinematics, self.camera, self.group, self.weight, deformed=deformed,
                         prepared=self.correlation)


@dataclass(frozen=True)
class FrameView(View):
    """A camera's pixels of a subdomain in one frame: those that count of the reference image, and the deformed one.

    Of its methods, ``q`` are the subdomain's unknowns, (n_unknowns,), ``gain``, no unit, and ``offset``, grey levels,
    those of f = gain g + offset.

    Attributes
    ----------
    deformed : DeformedSubImage
        Window of the deformed image.
    prepared : Correlation
        What the reference image alone gave, nothing excluded or blurred for the frame's sake.
    """

    deformed: DeformedSubImage = field(kw_only=True)
    prepared: Correlation = field(kw_only=True)

    def find_displaced_window(self, q: Array) -> Window:
        """Find the window of the deformed image that unknowns need."""
        return self.correlation.find_displaced_window(self.kinematics.displacement(q))

    def compute_residual(self, q: Array, *, all_kinds: bool = False) -> Residual:
        """Pass over all pixels once for moments and sums of f - g(x + u), ``all_kinds`` for grey-level corrections."""
        return self.correlation.compute_residual(self.deformed, self.kinematics.displacement(q), all_kinds=all_kinds)

    def assemble_right_hand_side(self, residual: Residual, gain: Correction = 1.0, offset: Correction = 0.0) -> Array:
        """Assemble b of this camera in the subdomain's unknowns, w T^T b, Eq. 7 of [BP17].

        The camera's part of b_s, (n_unknowns,), grey levels squared per pixel, from the residual of
        ``compute_residual``.
        """
        b = self.correlation.assemble_right_hand_side(residual, gain, offset)
        projected = self.kinematics.project_vector(b)
        return projected if self.weight == 1.0 else self.weight * projected

    def compute_residual_image(self, q: Array, gain: Correction = 1.0, offset: Correction = 0.0) -> NDArray[np.float32]:
        """Compute f - gain g(x + u) - offset on the reference window, grey levels; nan on pixels that do not count."""
        return self.correlation.compute_residual_image(self.deformed, self.kinematics.displacement(q), gain, offset)

    def compute_residual_bands(self, q: Array, bands: Iterable[RowBand], gain: Correction = 1.0,
                               offset: Correction = 0.0) -> Iterator[NDArray[np.float32]]:
        """Compute the same as ``compute_residual_image`` band by band, each when it is asked for.

        On the windows of the bands, which are those of the view's correlation; nan also on pixels that other bands
        have.
        """
        displacement = self.kinematics.displacement(q)
        return self.correlation.compute_residual_bands(self.deformed, displacement, bands, gain, offset)

    def without_hidden(self, q: Array) -> Self:
        """Leave out the pixels that unknowns hide: outside the deformed image, or on excluded pixels of it."""
        correlation = self.correlation.without_hidden(self.deformed, self.kinematics.displacement(q))
        return replace(self, correlation=correlation)
