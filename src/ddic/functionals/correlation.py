"""Grey-level conservation f(x) = g(x + u(x)) on one subdomain: M, b and the residual, Eq. 5 of [BP17]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray
from scipy import sparse

from ddic.errors import InputError
from ddic.functionals import pixel_kernels as kernels
from ddic.functionals.grey_statistics import GreySums
from ddic.functionals.line_band import find_band_pixels
from ddic.functionals.moved_gradient import compute_inverse_deformations, map_hessians, map_moments
from ddic.functionals.torn_cells import find_torn_cells
from ddic.images.spline import HALO, PADDING, GradientImage, SplineImage
from ddic.images.sub_image import DeformedSubImage, MaskedSource, read_reference
from ddic.images.threads import ONE_THREAD, Threads
from ddic.images.window import Window, merge_windows
from ddic.kinematics.cell_interpolation import CellInterpolation, interpolate_cells
from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import Raster, rasterize
from ddic.mesh.shapes import pad_cells

BAND = 32
"""Height, pixels, of the bands in which cells are visited: of 16-px cells two rows. With a larger one, neighbours in a
row are further apart in time and share fewer lines of the cache; with a smaller one, those of a column do."""

FEWEST = 128
"""Cells of a thread's slice, some 0.2 ms: handing it over and the kernel's scratch arrays cost a tenth of that.
Larger slices leave threads idle on small subdomains."""

_NOTHING_EXCLUDED = np.zeros((0, 0), dtype=np.uint8)


@dataclass(frozen=True)
class Residual:
    """What one pass over a subdomain's pixels yields.

    Attributes
    ----------
    moments : (n_cells, 3, 2, 4) array
        Sums of (r, g, 1) x grad f x monomials, r = f - g(x + u); the last two are 0 where they were not asked for.
    cell_sums : GreySums
        Of every cell, (n_cells, 6).
    """

    moments: NDArray[np.float64]
    cell_sums: GreySums

    @property
    def sums(self) -> GreySums:
        """Sums over the whole subdomain, (6,)."""
        return GreySums(self.cell_sums.values.sum(axis=0))

    @property
    def n_pixels(self) -> int:
        """Number of the subdomain's pixels that count, in both images."""
        return int(self.sums.n_pixels)


@dataclass(frozen=True)
class Correlation:
    """One subdomain's pixels, reference image and interpolation.

    Attributes
    ----------
    mesh : Mesh
        The subdomain, in the image's pixels.
    interpolation : CellInterpolation
        From nodal displacements to those of the cells' pixels, and back to nodal forces.
    raster : Raster
        Every cell's pixels.
    reference : GradientImage
        f and grad f on a window that holds them.
    extent : Window
        The whole image.
    order : (n_cells,) int64 array
        Cells from left to right in bands of BAND rows, whatever the mesh's order: neighbours share the cache's lines.
    threads : Threads
        They take slices of the cells; what comes of a cell depends on its pixels alone.
    inverse_deformations : (n_cells, 2, 2) array, optional
        F^-1 of each cell: F^-T grad f is then taken for the gradient in M and b. None, by default, takes grad f.
    """

    mesh: Mesh
    interpolation: CellInterpolation
    raster: Raster
    reference: GradientImage
    extent: Window
    order: NDArray[np.int64]
    threads: Threads = ONE_THREAD
    inverse_deformations: NDArray[np.float64] | None = None

    def with_moved_gradient(self, u: NDArray[np.float64]) -> Correlation:
        """Take the gradient of the deformed image where a displacement puts it, in M and in b.

        Parameters
        ----------
        u : (n_dofs,) array
            Nodal displacement, pixels.

        Returns
        -------
        Correlation
            The same pixels.
        """
        return replace(self, inverse_deformations=compute_inverse_deformations(self.mesh, u))

    @property
    def n_usable_pixels(self) -> int:
        """Number of pixels that the reference image does not exclude."""
        if self.reference.usable is None:
            return int(self.raster.pixel_counts.sum())
        return self._count_pixels(self.reference.usable)

    def count_visible_pixels(self, deformed: DeformedSubImage, q: NDArray[np.float64]) -> int:
        """Count the pixels that a displacement shows in both images.

        Costs one pass over the pixels where some may be hidden; where there is a residual, ``Residual.n_pixels`` says
        the same for nothing.

        Parameters
        ----------
        deformed : DeformedSubImage
            g.
        q : (n_dofs,) array
            Nodal displacement, pixels.

        Returns
        -------
        int
            Of ``n_usable_pixels``, those not mapped outside the deformed image or onto excluded pixels of it.
        """
        if self._shows_all(deformed, q):
            return self.n_usable_pixels
        return self.compute_residual(deformed, q).n_pixels

    def without_hidden(self, deformed: DeformedSubImage, q: NDArray[np.float64]) -> Correlation:
        """Leave out the pixels that a displacement maps outside the deformed image or onto excluded pixels of it.

        From M as well as from b: a displacement that no pixel sees is not held by any.

        Parameters
        ----------
        deformed : DeformedSubImage
            g.
        q : (n_dofs,) array
            Nodal displacement, pixels.

        Returns
        -------
        Correlation
            With fewer usable pixels; the same object where none is hidden.
        """
        if self._shows_all(deformed, q):
            return self
        shown = np.isfinite(self.compute_residual_image(deformed, q)).astype(np.uint8)
        if self._count_pixels(shown) == self.n_usable_pixels:
            return self
        if self.reference.usable is not None:
            shown &= self.reference.usable
        return replace(self, reference=replace(self.reference, usable=shown))

    def compute_cell_hessians(self) -> NDArray[np.float64]:
        """Sum N^T grad f grad f^T N over the pixels of every cell.

        Returns
        -------
        (n_cells, 8, 8) array
            M_e, node-major, grey levels squared per pixel squared; Eq. 5 of [BP17].
        """
        shapes = kernels.Shapes(self.interpolation.shapes, self.interpolation.kinds)
        reference = self._reference_pixels
        n_cells = len(self.order)
        hessians = np.zeros((n_cells, 4, 2, 4, 2))

        def accumulate(place: slice) -> None:
            kernels.hessian_cells(self._cells(self.order[place]), shapes, reference, hessians)

        self.threads.run_over(n_cells, FEWEST, accumulate)
        return hessians.reshape(n_cells, 8, 8)

    def assemble_hessian(self) -> sparse.csr_matrix:
        """Assemble M = sum_px N^T grad f grad f^T N over the subdomain's usable pixels.

        Returns
        -------
        (n_dofs, n_dofs) csr_matrix
            M, grey levels squared per pixel squared; Eq. 5 of [BP17].
        """
        hessians = self.compute_cell_hessians()
        if self.inverse_deformations is not None:
            hessians = map_hessians(self.inverse_deformations, hessians)
        return self.interpolation.assemble_matrix(hessians)

    def compute_residual(self, deformed: DeformedSubImage, q: NDArray[np.float64], *,
                         all_kinds: bool = False) -> Residual:
        """Sum the residual f - g(x + u), against grad f too, in one pass over the subdomain's pixels.

        Parameters
        ----------
        deformed : DeformedSubImage
            g.
        q : (n_dofs,) array
            Nodal displacement, pixels.
        all_kinds : bool
            Whether to sum what a grey-level correction needs too.

        Returns
        -------
        Residual
            Sums by cell.
        """
        n_cells = len(self.order)
        u = self.interpolation.monomial_coefficients(q)
        reference = self._reference_pixels
        pixels = self._deformed_pixels(deformed.get_spline(self.find_displaced_window(q)))
        order = self._order_whole_cells(q)
        sums = kernels.CellSums(np.zeros((n_cells, 3, 2, 4)), np.zeros((n_cells, kernels.N_SUMS)))

        def accumulate(place: slice) -> None:
            kernels.residual_sums(self._cells(order[place]), u, reference, pixels, all_kinds, sums)

        self.threads.run_over(len(order), FEWEST, accumulate)
        return Residual(sums.moments, GreySums(sums.grey))

    def assemble_right_hand_side(self, residual: Residual, gain: NDArray[np.float64] | float = 1.0,
                                 offset: NDArray[np.float64] | float = 0.0) -> NDArray[np.float64]:
        """Assemble b = sum_px N^T grad f (f - gain g(x + u) - offset).

        Parameters
        ----------
        residual : Residual
            With all kinds of moments where gain is not 1 or offset not 0.
        gain : float or (n_cells,) array
            No unit.
        offset : float or (n_cells,) array
            Grey levels.

        Returns
        -------
        (n_dofs,) array
            b, grey levels squared per pixel; Eq. 5 of [BP17].
        """
        moments = residual.moments
        if self.inverse_deformations is not None:
            moments = map_moments(self.inverse_deformations, moments)
        of_r, of_g, of_one = moments[:, 0], moments[:, 1], moments[:, 2]
        if np.all(np.equal(gain, 1.0)) and not np.any(offset):
            return self.interpolation.assemble_vector(of_r)
        excess = np.broadcast_to(np.asarray(gain) - 1.0, len(moments))[:, None, None]
        shift = np.broadcast_to(np.asarray(offset), len(moments))[:, None, None]
        return self.interpolation.assemble_vector(of_r - excess * of_g - shift * of_one)

    def compute_residual_image(self, deformed: DeformedSubImage, q: NDArray[np.float64],
                               gain: NDArray[np.float64] | float = 1.0,
                               offset: NDArray[np.float64] | float = 0.0) -> NDArray[np.float32]:
        """Compute the residual f - gain g(x + u) - offset of every pixel.

        Parameters
        ----------
        deformed : DeformedSubImage
            g.
        q : (n_dofs,) array
            Nodal displacement, pixels.
        gain : float or (n_cells,) array
            No unit.
        offset : float or (n_cells,) array
            Grey levels.

        Returns
        -------
        (height, width) float32 array
            On the reference window, grey levels; NaN on pixels that do not count.
        """
        n_cells = len(self.order)
        u = self.interpolation.monomial_coefficients(q)
        reference = self._reference_pixels
        pixels = self._deformed_pixels(deformed.get_spline(self.find_displaced_window(q)))
        order = self._order_whole_cells(q)
        gains = np.array(np.broadcast_to(np.asarray(gain, dtype=float), n_cells))
        offsets = np.array(np.broadcast_to(np.asarray(offset, dtype=float), n_cells))
        image = np.full(self.reference.values.shape, np.nan, dtype=np.float32)

        def write(place: slice) -> None:
            kernels.fill_residual_pixels(self._cells(order[place]), u, reference, pixels, gains, offsets, image)

        self.threads.run_over(len(order), FEWEST, write)
        return image

    def find_displaced_window(self, q: NDArray[np.float64]) -> Window:
        """Find the window of the deformed image that holds all displaced pixels and their neighbours.

        But those of torn cells, which count as displaced out of the image.

        Parameters
        ----------
        q : (n_dofs,) array
            Nodal displacement, pixels.

        Returns
        -------
        Window
            It may leave the image.
        """
        # u is a convex combination of nodal values, so the displaced nodes' box holds all displaced pixels.
        displaced = self._displaced_nodes(q)
        torn = self._find_torn_cells(q)
        if len(torn):
            displaced = displaced[np.unique(np.delete(pad_cells(self.mesh), torn, axis=0))]
        if not len(displaced):
            return Window(0, 0, 1, 1)
        # One component after the other: numpy is slow where it looks for the least of pairs.
        by_component = np.ascontiguousarray(displaced.T)
        left, top = np.floor(by_component.min(axis=1)).astype(int)
        right, bottom = np.ceil(by_component.max(axis=1)).astype(int)
        return Window(int(left) - 1, int(top) - 1, int(right) + 2, int(bottom) + 2)

    def _find_torn_cells(self, q: NDArray[np.float64]) -> NDArray[np.int64]:
        return find_torn_cells(self.mesh, q.reshape(self.mesh.nodes.shape))

    def _order_whole_cells(self, q: NDArray[np.float64]) -> NDArray[np.int64]:
        """The cells that are not torn, in the order of visiting."""
        torn = self._find_torn_cells(q)
        return self.order[~np.isin(self.order, torn)] if len(torn) else self.order

    def _displaced_nodes(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Nodes x + u, (n_nodes, 2), pixels."""
        return np.asarray(self.mesh.nodes + q.reshape(self.mesh.nodes.shape))

    def _shows_all(self, deformed: DeformedSubImage, q: NDArray[np.float64]) -> bool:
        """Whether no pixel can be hidden, as far as can be told without looking at pixels."""
        if deformed.source.may_exclude:
            return False
        # All pixels stay within the outermost pixel centres where all nodes do.
        displaced = self._displaced_nodes(q)
        last = (self.extent.width - 1, self.extent.height - 1)
        return bool((displaced >= 0).all() and (displaced <= last).all()) and not len(self._find_torn_cells(q))

    def _count_pixels(self, usable: NDArray[np.uint8]) -> int:
        """Number of the cells' pixels that are 1 in an image of the reference window's shape."""
        window = self.reference.window
        return int(self.raster.sum_by_cell(usable, window.x0, window.y0).sum())

    def _cells(self, order: NDArray[np.int64]) -> kernels.Cells:
        """Cells in the order of visiting."""
        raster = self.raster
        return kernels.Cells(order, self.interpolation.geometry, raster.first_row, raster.row_ptr,
                             raster.starts, raster.stops)

    @cached_property
    def _reference_pixels(self) -> kernels.ReferencePixels:
        """The reference image as kernels take it; kept, because on a small subdomain it would cost some per cent."""
        f = self.reference
        return kernels.ReferencePixels(_flatten(f.values), _flatten(f.by_x), _flatten(f.by_y), _row_length(f.values),
                                       f.window.x0, f.window.y0, _or_nothing(f.usable))

    def _deformed_pixels(self, g: SplineImage) -> kernels.DeformedPixels:
        """The deformed image as kernels take it."""
        return kernels.DeformedPixels(_flatten(g.coefficients), _row_length(g.coefficients), g.degree,
                                      g.window.x0, g.window.y0, _or_nothing(g.usable),
                                      self.extent.width, self.extent.height)


def read_correlation(mesh: Mesh, reference: MaskedSource, degree: int) -> Correlation:
    """Rasterise a subdomain's mesh and read its window of the reference image.

    Parameters
    ----------
    mesh : Mesh
        In the image's pixels.
    reference : MaskedSource
        The reference image.
    degree : int
        Of the spline, 3 or 5.

    Returns
    -------
    Correlation
        Of the subdomain.

    Raises
    ------
    InputError
        Where a pixel of the mesh lies outside the image.
    """
    return read_correlations([mesh], reference, degree)[0][0]


def read_correlations(meshes: Sequence[Mesh], reference: MaskedSource, degree: int,
                      threads: Threads = ONE_THREAD) -> list[list[Correlation]]:
    """Rasterise several subdomains' meshes and read their windows of the reference image.

    Neighbours share a window where it holds fewer pixels than their own ones, whose edges and halos overlap.

    Parameters
    ----------
    meshes : sequence of Mesh
        In the image's pixels.
    reference : MaskedSource
        The reference image.
    degree : int
        Of the spline, 3 or 5.
    threads : Threads
        Of all that is done with the subdomains' pixels.

    Returns
    -------
    list of lists of Correlation
        Groups, in the meshes' order, that share a window of the image.

    Raises
    ------
    InputError
        Where a pixel of a mesh lies outside the image.
    """
    rasters = [rasterize(mesh) for mesh in meshes]
    windows = [raster.window for raster in rasters]
    extent = reference.extent
    if not all(extent.contains(window) for window in windows):
        raise InputError(f"{reference.image.path}: pixels of the mesh lie outside the image "
                         f"({extent.width} x {extent.height} px); move or cut the mesh")
    groups: list[list[Correlation]] = []
    for common, members in merge_windows(windows, HALO[degree] + PADDING[degree]):
        image = read_reference(reference, common, degree, threads)
        groups.append([])
        for k in members:
            own = _without_band(meshes[k], rasters[k], image.restrict(windows[k]), degree)
            groups[-1].append(_correlation(meshes[k], rasters[k], own, extent, threads))
    return groups


def restrict_to_cells(whole: Correlation, cells: NDArray[np.int64]) -> Correlation:
    """Take some of a subdomain's cells alone, with the same window of the image.

    Parameters
    ----------
    whole : Correlation
        The subdomain.
    cells : (n,) int64 array
        Their numbers.

    Returns
    -------
    Correlation
        Of these cells.
    """
    mesh, _ = whole.mesh.create_submesh(cells)
    return _correlation(mesh, rasterize(mesh), whole.reference, whole.extent, whole.threads)


def _correlation(mesh: Mesh, raster: Raster, image: GradientImage, extent: Window, threads: Threads) -> Correlation:
    """Put the cells in order."""
    x, y = mesh.centroids.T
    order = np.lexsort((x, y // BAND)).astype(np.int64)
    return Correlation(mesh, interpolate_cells(mesh), raster, image, extent, order, threads)


def _without_band(mesh: Mesh, raster: Raster, image: GradientImage, degree: int) -> GradientImage:
    """The window of the reference image with the pixels near a discontinuity left out."""
    pixels, _ = find_band_pixels(mesh, raster, degree)
    if not len(pixels):
        return image
    usable = np.ones(image.values.shape, dtype=np.uint8) if image.usable is None else image.usable.copy()
    usable[pixels[:, 1] - image.window.y0, pixels[:, 0] - image.window.x0] = 0
    return replace(image, usable=usable)


def _flatten(image: NDArray[Any]) -> NDArray[Any]:
    """An image (height, width), or a part of one, as one sequence of rows of ``_row_length``."""
    if image.flags.c_contiguous:
        return image.reshape(-1)
    height, width = image.shape
    n = (height - 1) * _row_length(image) + width
    return as_strided(image, (n,), (image.itemsize,))


def _row_length(image: NDArray[Any]) -> int:
    """Numbers from one row of an image, or of a part of one, to the next."""
    return int(image.strides[0] // image.itemsize)


def _or_nothing(usable: NDArray[np.uint8] | None) -> NDArray[np.uint8]:
    """An array whether or not anything is excluded, so that kernels are compiled once."""
    return _NOTHING_EXCLUDED if usable is None else usable
