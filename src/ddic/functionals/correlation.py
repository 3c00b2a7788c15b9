"""Grey-level conservation f(x) = g(x + u(x)) on one subdomain: M, b and the residual, Eq. 5 of [BP17]."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.functionals import pixel_kernels as kernels
from ddic.functionals.grey_statistics import GreySums
from ddic.functionals.kernel_images import convert_deformed, convert_reference
from ddic.functionals.moved_gradient import compute_inverse_deformations, map_hessians, map_moments
from ddic.functionals.torn_cells import find_torn_cells
from ddic.images.spline import GradientImage
from ddic.images.sub_image import DeformedSubImage, MaskedSource
from ddic.images.threads import ONE_THREAD, Threads
from ddic.images.window import Window
from ddic.kinematics.cell_interpolation import CellInterpolation
from ddic.mesh.mesh import Mesh, pad_cells
from ddic.mesh.raster import Raster

FEWEST = 128
"""Cells of a thread's slice, some 0.2 ms: handing it over and the kernel's scratch arrays cost a tenth of that.
Larger slices leave threads idle on small subdomains."""


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
class _DisplacedPixels:
    """What kernels take of a displacement.

    order : (n,) cells to visit, in this order; u : (n_cells, 2, 4) coefficients of the displacement on the monomials,
    pixels; g : the deformed image on a window that holds all displaced pixels.
    """

    order: NDArray[np.int64]
    u: NDArray[np.float64]
    g: kernels.DeformedPixels


@dataclass(frozen=True)
class Band:
    """Cells whose pixels begin in some rows of the image.

    Attributes
    ----------
    order : (n,) int64 array
        Their numbers, in the order of visiting.
    window : Window
        Rows of the reference window that hold all their pixels.
    """

    order: NDArray[np.int64]
    window: Window


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
    source : MaskedSource
        The whole reference image.
    order : (n,) int64 array
        Cells in the order of visiting, whatever the mesh's: neighbours share the cache's lines. All of them, or those
        that a pass is confined to: sums over the pixels of the others are 0.
    threads : Threads
        They take slices of the cells; what comes of a cell depends on its pixels alone.
    inverse_deformations : (n_cells, 2, 2) array, optional
        F^-1 of each cell: F^-T grad f is then taken for the gradient in M and b. None, by default, takes grad f.
    """

    mesh: Mesh
    interpolation: CellInterpolation
    raster: Raster
    reference: GradientImage
    source: MaskedSource
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
    def extent(self) -> Window:
        """The whole image's pixels."""
        return self.source.extent

    def confine(self, cells: NDArray[np.bool_]) -> Correlation:
        """Confine passes over the pixels to some cells, (n_cells,)."""
        return replace(self, order=self.order[cells[self.order]])

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
        return replace(self, reference=self.reference.exclude(shown == 0))

    def compute_cell_hessians(self) -> NDArray[np.float64]:
        """Sum N^T grad f grad f^T N over the pixels of every cell, grad f moved where it is asked for.

        Returns
        -------
        (n_cells, 8, 8) array
            M_e, node-major, grey levels squared per pixel squared; Eq. 5 of [BP17].
        """
        shapes = kernels.Shapes(self.interpolation.shapes, self.interpolation.kinds)
        reference = self._reference_pixels
        n_cells = self.mesh.n_cells
        hessians = np.zeros((n_cells, 4, 2, 4, 2))

        def accumulate(place: slice) -> None:
            kernels.hessian_cells(self._take_cells(self.order[place]), shapes, reference, hessians)

        self.threads.run_over(len(self.order), FEWEST, accumulate)
        hessians = hessians.reshape(n_cells, 8, 8)
        return hessians if self.inverse_deformations is None else map_hessians(self.inverse_deformations, hessians)

    def assemble_hessian(self, cells: NDArray[np.int64] | None = None) -> sparse.csr_matrix:
        """Assemble M = sum_px N^T grad f grad f^T N over the subdomain's usable pixels.

        Parameters
        ----------
        cells : (n,) int64 array, optional
            Numbers of the cells whose pixels count; by default all of them do.

        Returns
        -------
        (n_dofs, n_dofs) csr_matrix
            M, grey levels squared per pixel squared; Eq. 5 of [BP17].
        """
        if cells is None:
            return self.interpolation.assemble_matrix(self.compute_cell_hessians())
        of_cells = replace(self, order=cells).compute_cell_hessians()[cells]
        return self.interpolation.assemble_matrix(of_cells, cells)

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
        n_cells = self.mesh.n_cells
        displaced, reference = self._displace_pixels(deformed, q), self._reference_pixels
        sums = kernels.CellSums(np.empty((n_cells, 3, 2, 4)), np.empty((n_cells, kernels.N_SUMS)))
        for values in sums:
            # np.zeros would have the system clear small pages one by one while the kernel runs, a tenth of its time.
            values.fill(0.0)

        def accumulate(place: slice) -> None:
            cells = self._take_cells(displaced.order[place])
            kernels.residual_sums(cells, displaced.u, reference, displaced.g, all_kinds, sums)

        self.threads.run_over(len(displaced.order), FEWEST, accumulate)
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
        return self.interpolation.assemble_vector(self._correct_moments(residual, gain, offset))

    def compute_cell_forces(self, cells: NDArray[np.int64], residual: Residual,
                            gain: NDArray[np.float64] | float = 1.0,
                            offset: NDArray[np.float64] | float = 0.0) -> NDArray[np.float64]:
        """Sum N^T grad f (f - gain g(x + u) - offset) over the pixels of some cells.

        Parameters
        ----------
        cells : (n,) array of int64
            Their numbers.
        residual : Residual
            With all kinds of moments where gain is not 1 or offset not 0.
        gain : float or (n_cells,) array
            No unit.
        offset : float or (n_cells,) array
            Grey levels.

        Returns
        -------
        (n, 8) array
            b_e, node-major, grey levels squared per pixel.
        """
        return self.interpolation.take_to_corners(cells, self._correct_moments(residual, gain, offset)[cells])

    def _correct_moments(self, residual: Residual, gain: NDArray[np.float64] | float,
                         offset: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """Moments of f - gain g(x + u) - offset against grad f, moved where it is asked for, (n_cells, 2, 4)."""
        moments = residual.moments
        if self.inverse_deformations is not None:
            moments = map_moments(self.inverse_deformations, moments)
        of_r, of_g, of_one = moments[:, 0], moments[:, 1], moments[:, 2]
        if np.all(np.equal(gain, 1.0)) and not np.any(offset):
            return of_r
        excess = np.broadcast_to(np.asarray(gain) - 1.0, len(moments))[:, None, None]
        shift = np.broadcast_to(np.asarray(offset), len(moments))[:, None, None]
        return np.asarray(of_r - excess * of_g - shift * of_one)

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
        whole = Band(self.order, self.reference.window)
        return next(self.compute_residual_bands(deformed, q, [whole], gain, offset))

    def split_bands(self, height: int) -> list[Band]:
        """Split the cells into bands of rows, whose residual images take little memory one by one.

        Parameters
        ----------
        height : int
            Of the bands, pixels; at least that of the tallest cell is taken. They are counted from the image's top.

        Returns
        -------
        list of Band
            Of all cells, each in one.
        """
        first = self.raster.first_row[self.order]
        last = first + np.diff(self.raster.row_ptr)[self.order]
        number = first // max(height, int((last - first).max(initial=0)))
        members = [np.flatnonzero(number == k) for k in np.unique(number)]
        window = self.reference.window
        return [Band(self.order[of_band], Window(window.x0, max(int(first[of_band].min()), window.y0),
                                                 window.x1, min(int(last[of_band].max()), window.y1)))
                for of_band in members]

    def compute_residual_bands(self, deformed: DeformedSubImage, q: NDArray[np.float64], bands: Iterable[Band],
                               gain: NDArray[np.float64] | float = 1.0,
                               offset: NDArray[np.float64] | float = 0.0) -> Iterator[NDArray[np.float32]]:
        """Compute the same as ``compute_residual_image`` band by band, each when it is asked for.

        Parameters
        ----------
        deformed : DeformedSubImage
            g.
        q : (n_dofs,) array
            Nodal displacement, pixels.
        bands : iterable of Band
            Of ``split_bands``.
        gain : float or (n_cells,) array
            No unit.
        offset : float or (n_cells,) array
            Grey levels.

        Returns
        -------
        iterator of (height, width) float32 array
            On the bands' windows, grey levels; NaN on pixels that do not count, or that other bands have.
        """
        n_cells = self.mesh.n_cells
        displaced = self._displace_pixels(deformed, q)
        gains = np.array(np.broadcast_to(np.asarray(gain, dtype=float), n_cells))
        offsets = np.array(np.broadcast_to(np.asarray(offset, dtype=float), n_cells))
        is_visited = np.zeros(n_cells, dtype=bool)
        is_visited[displaced.order] = True
        for band in bands:
            visited = replace(displaced, order=band.order[is_visited[band.order]])
            yield self._draw_residual(visited, band.window, gains, offsets)

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

    def _displace_pixels(self, deformed: DeformedSubImage, q: NDArray[np.float64]) -> _DisplacedPixels:
        """Pixels of all cells that are not torn."""
        torn = self._find_torn_cells(q)
        order = self.order[~np.isin(self.order, torn)] if len(torn) else self.order
        g = deformed.get_spline(self.find_displaced_window(q))
        return _DisplacedPixels(order, self.interpolation.monomial_coefficients(q), convert_deformed(g, self.extent))

    def _draw_residual(self, displaced: _DisplacedPixels, window: Window, gains: NDArray[np.float64],
                       offsets: NDArray[np.float64]) -> NDArray[np.float32]:
        """Residual on a window that holds all pixels of the cells to visit."""
        reference = convert_reference(self.reference.restrict(window))
        image = np.full((window.height, window.width), np.nan, dtype=np.float32)

        def write(place: slice) -> None:
            cells = self._take_cells(displaced.order[place])
            kernels.fill_residual_pixels(cells, displaced.u, reference, displaced.g, gains, offsets, image)

        self.threads.run_over(len(displaced.order), FEWEST, write)
        return image

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

    def _take_cells(self, order: NDArray[np.int64]) -> kernels.Cells:
        """Cells as kernels take them, in the order of visiting."""
        raster = self.raster
        return kernels.Cells(order, self.interpolation.geometry, raster.first_row, raster.row_ptr,
                             raster.starts, raster.stops)

    @cached_property
    def _reference_pixels(self) -> kernels.ReferencePixels:
        """The reference image as kernels take it; kept, because on a small subdomain it would cost some per cent."""
        return convert_reference(self.reference)
