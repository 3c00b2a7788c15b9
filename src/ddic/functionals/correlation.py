"""Grey-level conservation f(x) = g(x + u(x)) on one subdomain: M, b and the residual, Eq. 5 of [BP17]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray
from scipy import sparse

from ddic.errors import InputError
from ddic.functionals.pixel_kernels import N_SUMS, hessian_cells, residual_pixels, residual_sums
from ddic.images.spline import HALO, PADDING, GradientImage
from ddic.images.sub_image import DeformedSubImage, MaskedSource, read_reference
from ddic.images.threads import ONE_THREAD, Threads
from ddic.images.window import Window, shared_windows
from ddic.kinematics.cell_interpolation import CellInterpolation, interpolate_cells
from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import Raster, rasterize

GreyCorrection = Literal["none", "global", "element"]

BAND = 32
"""Height, pixels, of the bands in which cells are visited."""

FEWEST = 128
"""Cells of a thread's slice, some 0.2 ms: handing it over and the kernel's scratch arrays cost a tenth of that."""

_NOTHING_EXCLUDED = np.zeros((0, 0), dtype=np.uint8)


@dataclass(frozen=True)
class GreySums:
    """Sums over pixels of (1, r, g, r^2, g^2, r g), r = f - g(x + u), from which all grey statistics follow.

    values: (..., 6) float64; the leading axes are cells, or nothing for a whole region.
    """

    values: NDArray[np.float64]

    @property
    def n_pixels(self) -> NDArray[np.float64]:
        """Number of pixels that count."""
        return np.asarray(self.values[..., 0])

    def gain_and_offset(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Least-squares a, b of f = a g + b; a = 1 where the deformed image is flat, (1, 0) without pixels."""
        n, r, g, _, gg, rg = np.moveaxis(self.values, -1, 0)
        n = np.maximum(n, 1.0)
        variance = gg / n - (g / n) ** 2
        textured = variance > 1e-12 * np.maximum(gg / n, 1e-300)
        excess = np.where(textured, (rg / n - r * g / n**2) / np.where(textured, variance, 1.0), 0.0)
        return 1.0 + excess, np.where(self.n_pixels > 0, r / n - excess * g / n, 0.0)

    def residual(self, gain: NDArray[np.float64] | float = 1.0, offset: NDArray[np.float64] | float = 0.0,
                 ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Sum of the residual f - gain g - offset and sum of its square."""
        n, r, g, rr, gg, rg = np.moveaxis(self.values, -1, 0)
        e = np.asarray(gain) - 1.0
        b = np.asarray(offset)
        first = r - e * g - b * n
        second = rr + e**2 * gg + b**2 * n - 2 * e * rg - 2 * b * r + 2 * e * b * g
        return first, np.maximum(second, 0.0)


@dataclass(frozen=True)
class Residual:
    """What one pass over a subdomain's pixels yields.

    moments: (n_cells, 3, 2, 4), sums of (r, g, 1) x grad f x monomials; cell_sums: (n_cells, 6).
    """

    moments: NDArray[np.float64]
    cell_sums: GreySums

    @property
    def sums(self) -> GreySums:
        """The sums over the whole subdomain."""
        return GreySums(self.cell_sums.values.sum(axis=0))


@dataclass(frozen=True)
class Correlation:
    """One subdomain's pixels, reference image and kinematics.

    order: (n_cells,) int64, cells from left to right in bands of BAND rows, whatever the mesh's order: neighbours
    share the cache's lines. threads: take slices of the cells; what comes of a cell depends on its pixels alone.
    """

    mesh: Mesh
    kinematics: CellInterpolation
    raster: Raster
    reference: GradientImage
    extent: Window
    order: NDArray[np.int64]
    threads: Threads = ONE_THREAD

    @property
    def n_usable_pixels(self) -> int:
        """Number of pixels that the reference image does not exclude."""
        f = self.reference
        if f.usable is None:
            return int(self.raster.pixel_counts.sum())
        return int(self.raster.counts_in(f.usable, f.window.x0, f.window.y0).sum())

    def seen_from(self, deformed: DeformedSubImage, q: NDArray[np.float64]) -> Correlation:
        """The same without the pixels that q maps outside the deformed image or onto excluded pixels of it.

        They must leave M as well as b: a displacement that no pixel sees is not held by any.
        """
        if not deformed.source.may_exclude and self._stays_inside(q):
            return self
        seen = np.isfinite(self.residual_image(deformed, q))
        if int(self.raster.counts_in(seen.astype(np.uint8), self.reference.window.x0,
                                     self.reference.window.y0).sum()) == self.n_usable_pixels:
            return self
        usable = seen.astype(np.uint8)
        if self.reference.usable is not None:
            usable &= self.reference.usable
        return replace(self, reference=replace(self.reference, usable=usable))

    def hessian_cells(self) -> NDArray[np.float64]:
        """M_e = sum_px N_i . grad f grad f^T . N_j of every cell, (n_cells, 8, 8), Eq. 5 of [BP17]."""
        k, r, f = self.kinematics, self.raster, self.reference
        out = np.zeros((len(k.geometry), 4, 2, 4, 2))

        def accumulate(place: slice) -> None:
            hessian_cells(self.order[place], k.geometry, k.shapes, k.kinds, r.first_row, r.row_ptr, r.starts, r.stops,
                          _flat(f.by_x), _flat(f.by_y), _row_length(f.by_x), _or_nothing(f.usable),
                          f.window.x0, f.window.y0, out)

        self.threads.over(len(self.order), FEWEST, accumulate)
        return out.reshape(len(out), 8, 8)

    def hessian(self) -> sparse.csr_matrix:
        """M of the subdomain, (n_dofs, n_dofs)."""
        return self.kinematics.assemble_matrix(self.hessian_cells())

    def residual(self, deformed: DeformedSubImage, q: NDArray[np.float64], *, all_kinds: bool = False) -> Residual:
        """One pass over all pixels with nodal displacement q (n_dofs,), pixels.

        all_kinds: also accumulate what a grey correction needs.
        """
        k, r, f = self.kinematics, self.raster, self.reference
        u = k.monomial_coefficients(q)
        spline = deformed.covering(self.displaced_window(q))
        moments = np.zeros((len(k.geometry), 3, 2, 4))
        sums = np.zeros((len(k.geometry), N_SUMS))

        def accumulate(place: slice) -> None:
            residual_sums(self.order[place], k.geometry, u, r.first_row, r.row_ptr, r.starts, r.stops,
                          _flat(f.values), _flat(f.by_x), _flat(f.by_y), _row_length(f.values),
                          _or_nothing(f.usable), f.window.x0, f.window.y0,
                          _flat(spline.coefficients), _row_length(spline.coefficients), spline.degree,
                          spline.window.x0, spline.window.y0, self.extent.width, self.extent.height,
                          _or_nothing(spline.usable), all_kinds,
                          moments, sums)

        self.threads.over(len(self.order), FEWEST, accumulate)
        return Residual(moments, GreySums(sums))

    def right_hand_side(self, residual: Residual, gain: NDArray[np.float64] | float = 1.0,
                        offset: NDArray[np.float64] | float = 0.0) -> NDArray[np.float64]:
        """b_j = sum_px N_j . grad f (f - gain g(x + u) - offset), (n_dofs,), Eq. 5 of [BP17].

        gain, offset: one number, or one per cell (n_cells,).
        """
        m = residual.moments
        excess = np.broadcast_to(np.asarray(gain) - 1.0, len(m))[:, None, None]
        shift = np.broadcast_to(np.asarray(offset), len(m))[:, None, None]
        return self.kinematics.assemble_vector(m[:, 0] - excess * m[:, 1] - shift * m[:, 2])

    def residual_image(self, deformed: DeformedSubImage, q: NDArray[np.float64],
                       gain: NDArray[np.float64] | float = 1.0,
                       offset: NDArray[np.float64] | float = 0.0) -> NDArray[np.float32]:
        """Residual f - gain g(x + u) - offset on the reference window, NaN on pixels that do not count."""
        k, r, f = self.kinematics, self.raster, self.reference
        spline = deformed.covering(self.displaced_window(q))
        out = np.full(f.values.shape, np.nan, dtype=np.float32)
        n_cells, u = len(k.geometry), k.monomial_coefficients(q)
        gains, offsets = (np.array(np.broadcast_to(np.asarray(a, dtype=float), n_cells)) for a in (gain, offset))

        def write(cells: slice) -> None:
            residual_pixels(k.geometry[cells], u[cells], r.first_row[cells], r.row_ptr[cells.start:cells.stop + 1],
                            r.starts, r.stops, _flat(f.values), _row_length(f.values), _or_nothing(f.usable),
                            f.window.x0, f.window.y0, _flat(spline.coefficients), _row_length(spline.coefficients),
                            spline.degree, spline.window.x0, spline.window.y0, self.extent.width, self.extent.height,
                            _or_nothing(spline.usable), gains[cells], offsets[cells], out)

        self.threads.over(n_cells, FEWEST, write)
        return out

    def _stays_inside(self, q: NDArray[np.float64]) -> bool:
        """Whether all nodes, hence all pixels, stay within the outermost pixel centres."""
        displaced = self.mesh.nodes + q.reshape(self.mesh.nodes.shape)
        return bool((displaced >= 0).all() and (displaced <= (self.extent.width - 1, self.extent.height - 1)).all())

    def displaced_window(self, q: NDArray[np.float64]) -> Window:
        """Window of the deformed image that holds all displaced pixels and their neighbours."""
        # u is a convex combination of nodal values, so the displaced nodes' box holds all displaced pixels.
        displaced = self.mesh.nodes + q.reshape(self.mesh.nodes.shape)
        low = np.floor(displaced.min(axis=0)).astype(int)
        high = np.ceil(displaced.max(axis=0)).astype(int)
        return Window(int(low[0]) - 1, int(low[1]) - 1, int(high[0]) + 2, int(high[1]) + 2)


def correlation(mesh: Mesh, reference: MaskedSource, degree: int) -> Correlation:
    """Rasterise a subdomain's mesh and read its window of the reference image.

    Raises InputError where a pixel of the mesh lies outside the image.
    """
    return correlations([mesh], reference, degree)[0][0]


def correlations(meshes: Sequence[Mesh], reference: MaskedSource, degree: int,
                 threads: Threads = ONE_THREAD) -> list[list[Correlation]]:
    """The same for several subdomains: groups, in order, that share a window of the image.

    Neighbours do where their common window holds fewer pixels than their own ones, whose edges and halos overlap.
    Raises InputError where a pixel of a mesh lies outside the image.
    """
    rasters = [rasterize(mesh) for mesh in meshes]
    windows = [raster.window for raster in rasters]
    if not all(reference.extent.contains(window) for window in windows):
        raise InputError(f"{reference.image.path}: pixels of the mesh lie outside the image "
                         f"({reference.extent.width} x {reference.extent.height} px); move or cut the mesh")
    found = []
    for common, members in shared_windows(windows, HALO[degree] + PADDING[degree]):
        image = read_reference(reference, common, degree, threads)
        found.append([_correlation(meshes[k], rasters[k], image.part(windows[k]), reference.extent, threads)
                      for k in members])
    return found


def restricted(whole: Correlation, cells: NDArray[np.int64]) -> Correlation:
    """The same on some of a subdomain's cells, with the same window of the image."""
    mesh, _ = whole.mesh.submesh(cells)
    return _correlation(mesh, rasterize(mesh), whole.reference, whole.extent, whole.threads)


def _correlation(mesh: Mesh, raster: Raster, image: GradientImage, extent: Window, threads: Threads) -> Correlation:
    x, y = mesh.centroids.T
    order = np.lexsort((x, y // BAND)).astype(np.int64)
    return Correlation(mesh, interpolate_cells(mesh), raster, image, extent, order, threads)


def _flat(image: NDArray[Any]) -> NDArray[Any]:
    """An image (height, width), or a part of one, as one sequence of rows of ``_row_length``."""
    height, width = image.shape
    return as_strided(image, ((height - 1) * _row_length(image) + width,), (image.itemsize,))


def _row_length(image: NDArray[Any]) -> int:
    return int(image.strides[0] // image.itemsize)


def _or_nothing(usable: NDArray[np.uint8] | None) -> NDArray[np.uint8]:
    return _NOTHING_EXCLUDED if usable is None else usable
