"""Grey-level conservation f(x) = g(x + u(x)) on one subdomain: M, b (Eq. 7 of [BP17]) and the residual.

From meshes and a reference image to subdomains with their pixels. Images are as the pixel kernels take them: flat
arrays, the same types whether or not anything is excluded. Cells may be torn apart by a displacement, as one node that
is held by nothing does to those around it.

The gradient of the deformed image where the displacement puts a pixel, in Eq. 4 of [BP17], is F^-T grad f, F = I + grad
u. Gauss-Newton takes grad f for it, which is enough where little turns or stretches. By 10 % it converges slower, by
a rotation of 60 degrees not at all.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.arrays import Array, BoolArray, IntArray
from ddic.errors import InputError
from ddic.functionals import pixel_kernels, voxel_kernels
from ddic.functionals.grey_statistics import GreySums
from ddic.functionals.line_band import find_band_pixels
from ddic.functionals.pixel_kernels import N_SUMS, CellSums, PixelKernels, Shapes
from ddic.images.spline import HALO, PADDING, GradientImage
from ddic.images.sub_image import DeformedSubImage, MaskedSource, read_reference
from ddic.images.threads import ONE_THREAD, Threads
from ddic.images.voxel_prefilter import TAPS
from ddic.images.window import Window, merge_windows
from ddic.kinematics.cell_interpolation import CellInterpolation, interpolate_cells
from ddic.kinematics.strain import compute_displacement_gradients
from ddic.mesh.mesh import Mesh, pad_cells
from ddic.mesh.raster import Raster, rasterize
from ddic.mesh.refinement import RefinedMesh

PIXEL_KERNELS: dict[str, PixelKernels] = {"bilinear": pixel_kernels.COMPILED, "trilinear": voxel_kernels.COMPILED}
"""What sums over the pixels of cells, by the family of their types."""


BAND_PIXELS = 1 << 24
"""Pixels of which is told at a time whether they are hidden; a larger value takes more memory."""

TORN_SIZES, TORN_PIXELS = 4.0, 32.0
"""Sizes of a cell, and pixels beside these, by which displacements of its nodes must differ for it to be torn. No
specimen deforms like that: a cell that turns over differs by two sizes. Larger ones let a node that runs away pull in
more of the image."""


def find_torn_cells(mesh: Mesh, u: Array) -> IntArray:
    """Find the cells whose nodes are displaced so differently that their pixels can be nowhere in the image.

    Gives their sorted numbers. The mesh is in the image's pixels, as the nodal displacement ``u``, (n_nodes, dim).
    """
    # One component after the other: numpy is slow where it looks for the least of pairs.
    if np.ptp(np.ascontiguousarray(u.T), axis=1).max() <= TORN_PIXELS:
        return np.zeros(0, np.int64)
    cells = pad_cells(mesh)
    size = np.ptp(mesh.nodes[cells], axis=1).max(axis=1)
    difference = np.ptp(u[cells], axis=1).max(axis=1)
    return np.flatnonzero(difference > TORN_PIXELS + TORN_SIZES * size).astype(np.int64)


LARGE = 0.1
"""Norm of F - I from which on F^-T grad f is taken for the gradient. A larger value costs iterations, a smaller one
operators that only fit one image."""

LARGE_SHARE = 0.02
"""Share of all pixels from which on so large gradients count. A few cells may be a crack that continuous elements
smear, where the images turn and stretch nowhere. A larger share leaves more to slow convergence."""

LEAST_AREA, LARGEST_STRETCH = 0.2, 3.0
"""Least det F, and largest norm of F, of a cell whose displacement is believed. Others keep grad f."""


def compute_inverse_deformations(mesh: Mesh, u: Array) -> Array:
    """Compute F^-1 at the centre of every cell, (n_cells, dim, dim), no unit.

    By it grad g of Eq. 4 of [BP17] is F^-T grad f. It is the identity where a cell is folded, or stretched more than
    can be believed. The mesh is in the image's pixels, as the nodal displacement ``u``, (n_dofs,).
    """
    identity = np.eye(mesh.dim)
    deformation = identity + compute_displacement_gradients(mesh, u)
    believed = _is_believed(deformation)
    inverse = np.tile(identity, (mesh.n_cells, 1, 1))
    inverse[believed] = np.linalg.inv(deformation[believed])
    return inverse


def find_large_gradients(mesh: Mesh, u: Array) -> BoolArray:
    """Tell which cells have turned or stretched by much, (n_cells,).

    Those whose norm of F - I is above ``LARGE``, and whose displacement is believed. The mesh is in the image's pixels,
    as the nodal displacement ``u``, (n_dofs,).
    """
    gradients = compute_displacement_gradients(mesh, u)
    is_large = np.asarray(np.linalg.norm(gradients, axis=(1, 2)) > LARGE)
    if is_large.any():
        is_large &= _is_believed(np.eye(mesh.dim) + gradients)
    return is_large


def measure_deformation(before: Array | None, now: Array | None) -> float:
    """Measure how much the cells have turned and stretched: the largest norm of F_before^-1 F_now - I.

    ``before`` and ``now`` are F^-1 of each cell, (n_cells, dim, dim); None stands for the identity.
    """
    if now is None:
        return 0.0 if before is None else _find_largest(before)
    deformation = np.linalg.inv(now)
    return _find_largest(deformation if before is None else before @ deformation)


def _find_largest(deformation: Array) -> float:
    """Largest norm of F - I."""
    change = deformation - np.eye(deformation.shape[-1])
    return float(np.linalg.norm(change, axis=(1, 2)).max(initial=0.0))


def map_moments(inverse: Array, moments: Array) -> Array:
    """Turn each cell's sums of something times grad f into those of the same times F^-T grad f.

    Both are (n_cells, n_kinds, dim, n_monomials); ``inverse`` is F^-1 of each cell, (n_cells, dim, dim).
    """
    return np.asarray(np.einsum("eji,ekjm->ekim", inverse, moments, optimize=True))


def map_hessians(inverse: Array, hessians: Array) -> Array:
    """Turn sums of grad f grad f^T into those of F^-T grad f grad f^T F^-1.

    Both are M_e, (n_cells, n, n), node-major; ``inverse`` is F^-1 of each cell, (n_cells, dim, dim).
    """
    n_cells, n, _ = hessians.shape
    dim = inverse.shape[-1]
    blocks = hessians.reshape(n_cells, n // dim, dim, n // dim, dim)
    turned = np.einsum("eki,eakbl,elj->eaibj", inverse, blocks, inverse, optimize=True)
    return np.asarray(turned.reshape(n_cells, n, n))


def _is_believed(deformation: Array) -> BoolArray:
    sizes = np.linalg.norm(deformation, axis=(1, 2))
    most = LARGEST_STRETCH * np.sqrt(deformation.shape[-1])
    return np.asarray((np.linalg.det(deformation) >= LEAST_AREA) & (sizes <= most))


FEWEST = 128
"""Cells of a thread's slice, some 0.2 ms: handing it over and the kernel's scratch arrays cost a tenth of that.
Larger slices leave threads idle on small subdomains."""


@dataclass(frozen=True)
class Residual:
    """What one pass over a subdomain's pixels yields.

    Attributes
    ----------
    moments : (n_cells, 1 or 3, dim, n_monomials) array
        Sums of (r, g, 1) x grad f x monomials, r = f - g(x + u); without the last two where they were not asked for.
    cell_sums : GreySums
        Of every cell, (n_cells, 6).
    """

    moments: Array
    cell_sums: GreySums

    def correct_moments(self, gain: Array | float, offset: Array | float) -> Array:
        """Give the moments of f - gain g(x + u) - offset, (n_cells, dim, n_monomials).

        Gain and offset are one number or by cell. All kinds are there where gain is not 1 or offset not 0.
        """
        moments = self.moments
        if np.all(np.equal(gain, 1.0)) and not np.any(offset):
            return moments[:, 0]
        excess = np.broadcast_to(np.asarray(gain) - 1.0, len(moments))[:, None, None]
        shift = np.broadcast_to(np.asarray(offset), len(moments))[:, None, None]
        return np.asarray(moments[:, 0] - excess * moments[:, 1] - shift * moments[:, 2])

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

    order : (n,) cells to visit, in this order; u : (n_cells, dim, n_monomials) coefficients of the displacement on the
    monomials, pixels; g : the deformed image on a window that holds all displaced pixels, as kernels take it.
    """

    order: IntArray
    u: Array
    g: Any


@dataclass(frozen=True)
class RowBand:
    """Cells whose pixels begin in some rows of the image.

    Attributes
    ----------
    order : (n,) int64 array
        Their numbers, in the order of visiting.
    window : Window
        Rows of the reference window that hold all their pixels.
    """

    order: IntArray
    window: Window


@dataclass(frozen=True)
class Correlation:
    """One subdomain's pixels, reference image and interpolation.

    Of its methods, ``q`` and ``u`` are the nodal displacement, (n_dofs,), pixels; ``gain``, no unit, and ``offset``,
    grey levels, are one number or one a cell, (n_cells,).

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
    inverse_deformations : (n_cells, dim, dim) array, optional
        F^-1 of each cell: F^-T grad f is then taken for the gradient in M and b. None, by default, takes grad f.
    """

    mesh: Mesh
    interpolation: CellInterpolation
    raster: Raster
    reference: GradientImage
    source: MaskedSource
    order: IntArray
    threads: Threads = ONE_THREAD
    inverse_deformations: Array | None = None

    def with_moved_gradient(self, u: Array) -> Correlation:
        """Take the gradient of the deformed image where a displacement puts it, in M and in b."""
        return replace(self, inverse_deformations=compute_inverse_deformations(self.mesh, u))

    @property
    def extent(self) -> Window:
        """The whole image's pixels."""
        return self.source.extent

    def confine(self, cells: BoolArray) -> Correlation:
        """Confine passes over the pixels to some cells, (n_cells,)."""
        return replace(self, order=self.order[cells[self.order]])

    def count_pixels(self) -> IntArray:
        """Count the pixels of each cell that the reference image does not exclude, (n_cells,)."""
        window, usable = self.reference.window, self.reference.usable
        return self.raster.pixel_counts if usable is None else self.raster.sum_by_cell(usable, window)

    @property
    def n_usable_pixels(self) -> int:
        """Number of pixels that the reference image does not exclude."""
        if self.reference.usable is None:
            return int(self.raster.pixel_counts.sum())
        return self._count_pixels(self.reference.usable)

    def without_hidden(self, deformed: DeformedSubImage, q: Array) -> Correlation:
        """Leave out the pixels that a displacement maps outside the deformed image or onto excluded pixels of it.

        From M as well as from b: a displacement that no pixel sees is not held by any. Gives the same object where none
        is hidden.
        """
        if self._shows_all(deformed, q):
            return self
        window = self.reference.window
        shown = np.zeros(window.shape, dtype=np.uint8)
        bands = self.split_bands(max(1, BAND_PIXELS * window.sizes[-1] // window.n_pixels))
        for band, image in zip(bands, self.compute_residual_bands(deformed, q, bands, 1.0, 0.0), strict=True):
            shown[window.locate(band.window)] |= np.isfinite(image)
        if self._count_pixels(shown) == self.n_usable_pixels:
            return self
        return replace(self, reference=self.reference.exclude(shown == 0))

    def compute_cell_hessians(self) -> Array:
        """Sum N^T grad f grad f^T N over the pixels of every cell, grad f moved where it is asked for.

        M_e is (n_cells, n, n), n = n_monomials dim, node-major, grey levels squared per pixel squared; Eq. 7 of [BP17].
        """
        shapes = Shapes(self.interpolation.shapes, self.interpolation.kinds)
        reference = self._reference_pixels
        n_cells, n_nodes, dim = self.mesh.n_cells, self.mesh.n_monomials, self.mesh.dim
        hessians = np.zeros((n_cells, n_nodes, dim, n_nodes, dim))

        def accumulate(place: slice) -> None:
            self._kernels.hessian_cells(self._take_cells(self.order[place]), shapes, reference, hessians)

        self.threads.run_over(len(self.order), FEWEST, accumulate)
        hessians = hessians.reshape(n_cells, n_nodes * dim, n_nodes * dim)
        return hessians if self.inverse_deformations is None else map_hessians(self.inverse_deformations, hessians)

    def sum_slopes(self) -> Array:
        """Sum grad f grad f^T over the pixels of every cell, (n_cells, dim, dim), (grey levels per pixel) squared."""
        n_nodes, dim = self.mesh.n_monomials, self.mesh.dim
        # Shape functions add up to 1.
        by_node = self.compute_cell_hessians().reshape(-1, n_nodes, dim, n_nodes, dim)
        return np.asarray(by_node.sum(axis=(1, 3)))

    def assemble_hessian(self, cells: IntArray | None = None) -> sparse.csr_matrix:
        """Assemble M = sum_px N^T grad f grad f^T N over the usable pixels of some cells, by default of all.

        M is (n_dofs, n_dofs), grey levels squared per pixel squared; Eq. 7 of [BP17].
        """
        if cells is None:
            return self.interpolation.assemble_matrix(self.compute_cell_hessians())
        of_cells = replace(self, order=cells).compute_cell_hessians()[cells]
        return self.interpolation.assemble_matrix(of_cells, cells)

    def compute_residual(self, deformed: DeformedSubImage, q: Array, *, all_kinds: bool = False) -> Residual:
        """Sum the residual f - g(x + u), against grad f too, in one pass; for grey-level corrections ``all_kinds``."""
        n_cells = self.mesh.n_cells
        displaced, reference = self._displace_pixels(deformed, q), self._reference_pixels
        n_kinds = 3 if all_kinds else 1
        sums = CellSums(np.empty((n_cells, n_kinds, self.mesh.dim, self.mesh.n_monomials)), np.empty((n_cells, N_SUMS)))
        for values in sums:
            # np.zeros would have the system clear small pages one by one while the kernel runs, a tenth of its time.
            values.fill(0.0)

        def accumulate(place: slice) -> None:
            cells = self._take_cells(displaced.order[place])
            self._kernels.residual_sums(cells, displaced.u, reference, displaced.g, all_kinds, sums)

        self.threads.run_over(len(displaced.order), FEWEST, accumulate)
        return Residual(sums.moments, GreySums(sums.grey))

    def assemble_right_hand_side(self, residual: Residual, gain: Array | float = 1.0,
                                 offset: Array | float = 0.0) -> Array:
        """Assemble b = sum_px N^T grad f (f - gain g(x + u) - offset), (n_dofs,), grey levels squared per pixel.

        Eq. 7 of [BP17]. The residual has all kinds of moments where gain is not 1 or offset not 0.
        """
        return self.interpolation.assemble_vector(self._correct_moments(residual, gain, offset))

    def compute_cell_forces(self, cells: IntArray, residual: Residual, gain: Array | float,
                            offset: Array | float) -> Array:
        """Sum N^T grad f (f - gain g(x + u) - offset) over the pixels of some cells, given by number.

        b_e is (n, n_monomials dim), node-major, grey levels squared per pixel. The residual has all kinds of moments
        where gain is not 1 or offset not 0.
        """
        return self.interpolation.take_to_corners(cells, self._correct_moments(residual, gain, offset)[cells])

    def _correct_moments(self, residual: Residual, gain: Array | float, offset: Array | float) -> Array:
        """Moments of f - gain g(x + u) - offset against grad f, moved where it is asked for."""
        if self.inverse_deformations is not None:
            residual = replace(residual, moments=map_moments(self.inverse_deformations, residual.moments))
        return residual.correct_moments(gain, offset)

    def compute_residual_image(self, deformed: DeformedSubImage, q: Array, gain: Array | float = 1.0,
                               offset: Array | float = 0.0) -> NDArray[np.float32]:
        """Compute f - gain g(x + u) - offset on the reference window, grey levels; NaN on pixels that do not count."""
        whole = RowBand(self.order, self.reference.window)
        return next(self.compute_residual_bands(deformed, q, [whole], gain, offset))

    def split_bands(self, height: int) -> list[RowBand]:
        """Split the cells into bands of rows, or of planes, whose residual images take little memory one by one.

        Every cell is in one of them. ``height`` is that of the bands, pixels; at least that of the tallest cell is
        taken. They are counted from the image's top.
        """
        first = self.raster.first_rows[self.order, -1]
        last = first + self.raster.n_rows[self.order, -1]
        number = first // max(height, int((last - first).max(initial=0)))
        members = [np.flatnonzero(number == k) for k in np.unique(number)]
        window = self.reference.window
        return [RowBand(self.order[of_band], window.take_rows(max(int(first[of_band].min()), window.lower[-1]),
                                                           min(int(last[of_band].max()), window.upper[-1])))
                for of_band in members]

    def compute_residual_bands(self, deformed: DeformedSubImage, q: Array, bands: Iterable[RowBand],
                               gain: Array | float, offset: Array | float) -> Iterator[NDArray[np.float32]]:
        """Compute the same as ``compute_residual_image`` band by band, each when it is asked for.

        On the windows of the bands, which ``split_bands`` gives; NaN also on pixels that other bands have.
        """
        n_cells = self.mesh.n_cells
        displaced = self._displace_pixels(deformed, q)
        correction = np.empty((2, n_cells))
        correction[0], correction[1] = gain, offset
        is_visited = np.zeros(n_cells, dtype=bool)
        is_visited[displaced.order] = True
        for band in bands:
            visited = replace(displaced, order=band.order[is_visited[band.order]])
            yield self._draw_residual(visited, band.window, correction)

    def find_displaced_window(self, q: Array) -> Window:
        """Find the window of the deformed image that holds all displaced pixels and their neighbours.

        But those of torn cells, which count as displaced out of the image. It may leave the image.
        """
        # u is a convex combination of nodal values, so the displaced nodes' box holds all displaced pixels.
        displaced = self._displaced_nodes(q)
        torn = self._find_torn_cells(q)
        if len(torn):
            displaced = displaced[np.unique(np.delete(pad_cells(self.mesh), torn, axis=0))]
        if not len(displaced):
            return Window.of_size(*[1] * self.mesh.dim)
        # One component after the other: numpy is slow where it looks for the least of pairs.
        by_component = np.ascontiguousarray(displaced.T)
        lower, upper = np.floor(by_component.min(axis=1)), np.ceil(by_component.max(axis=1))
        return Window.between(lower, upper + 1).grow(1)

    def _find_torn_cells(self, q: Array) -> IntArray:
        return find_torn_cells(self.mesh, q.reshape(self.mesh.nodes.shape))

    def _displace_pixels(self, deformed: DeformedSubImage, q: Array) -> _DisplacedPixels:
        """Pixels of all cells that are not torn."""
        torn = self._find_torn_cells(q)
        order = self.order[~np.isin(self.order, torn)] if len(torn) else self.order
        g = deformed.get_spline(self.find_displaced_window(q))
        return _DisplacedPixels(order, self.interpolation.monomial_coefficients(q),
                                self._kernels.convert_deformed(g, self.extent))

    def _draw_residual(self, displaced: _DisplacedPixels, window: Window, correction: Array) -> NDArray[np.float32]:
        """Residual on a window that holds all pixels of the cells to visit."""
        reference = self._kernels.convert_reference(self.reference.restrict(window))
        image = np.full(window.shape, np.nan, dtype=np.float32)

        def write(place: slice) -> None:
            cells = self._take_cells(displaced.order[place])
            self._kernels.fill_residual_pixels(cells, displaced.u, reference, displaced.g, correction, image)

        self.threads.run_over(len(displaced.order), FEWEST, write)
        return image

    def _displaced_nodes(self, q: Array) -> Array:
        """Nodes x + u, (n_nodes, 2), pixels."""
        return np.asarray(self.mesh.nodes + q.reshape(self.mesh.nodes.shape))

    def _shows_all(self, deformed: DeformedSubImage, q: Array) -> bool:
        """Whether no pixel can be hidden, as far as can be told without looking at pixels."""
        if deformed.source.may_exclude:
            return False
        # All pixels stay within the outermost pixel centres where all nodes do.
        displaced = self._displaced_nodes(q)
        last = np.array(self.extent.sizes) - 1
        return bool((displaced >= 0).all() and (displaced <= last).all()) and not len(self._find_torn_cells(q))

    def _count_pixels(self, usable: NDArray[np.uint8]) -> int:
        """Number of the cells' pixels that are 1 in an image of the reference window's shape."""
        window = self.reference.window
        return int(self.raster.sum_by_cell(usable, window).sum())

    @property
    def _kernels(self) -> PixelKernels:
        return PIXEL_KERNELS[self.mesh.family]

    def _take_cells(self, order: IntArray) -> Any:
        """Cells as kernels take them, in the order of visiting."""
        return self._kernels.take_cells(order, self.interpolation, self.raster)

    @cached_property
    def _reference_pixels(self) -> Any:
        """The reference image as kernels take it; kept, because on a small subdomain it would cost some per cent."""
        return self._kernels.convert_reference(self.reference)


VISITED_ROWS = 32
"""Height, pixels, of the bands in which cells are visited: of 16-px cells two rows. With a larger one, neighbours in a
row are further apart in time and share fewer lines of the cache; with a smaller one, those of a column do."""


def read_correlation(mesh: Mesh, reference: MaskedSource, degree: int) -> Correlation:
    """Rasterise a subdomain's mesh, in the image's pixels, and read its window of the reference image.

    ``degree`` is that of the spline, 3 or 5. Raises InputError where a pixel of the mesh lies outside the image.
    """
    return read_correlations([mesh], reference, degree)[0][0]


def read_correlations(meshes: Sequence[Mesh], reference: MaskedSource, degree: int,
                      threads: Threads = ONE_THREAD) -> list[list[Correlation]]:
    """Rasterise several subdomains' meshes, in the image's pixels, and read their windows of the reference image.

    Neighbours share a window where it holds fewer pixels than their own ones, whose edges and halos overlap: what comes
    back are groups that share one, in the meshes' order. ``degree`` is that of the spline, 3 or 5; ``threads`` serve
    all that is done with the subdomains' pixels. Raises InputError where a pixel of a mesh lies outside the image.
    """
    rasters = [rasterize(mesh) for mesh in meshes]
    windows = [raster.window for raster in rasters]
    extent = reference.extent
    if not all(extent.contains(window) for window in windows):
        raise InputError(f"{reference.image.path}: pixels of the mesh lie outside the image "
                         f"({extent.describe()} px); move or cut the mesh")
    groups: list[list[Correlation]] = []
    halo = TAPS if len(extent.sizes) == 3 else HALO[degree]
    for common, members in merge_windows(windows, halo + PADDING[degree]):
        image = read_reference(reference, common, degree, threads)
        groups.append([])
        for k in members:
            own = _without_band(meshes[k], rasters[k], image.restrict(windows[k]), degree)
            groups[-1].append(_build_correlation(meshes[k], rasters[k], own, reference, threads))
    return groups


def restrict_to_cells(whole: Correlation, cells: IntArray) -> Correlation:
    """Take some of a subdomain's cells alone, given by number, with the same window of the image."""
    mesh, _ = whole.mesh.create_submesh(cells)
    return _build_correlation(mesh, rasterize(mesh), whole.reference, whole.source, whole.threads)


def refine_correlation(whole: Correlation, refined: RefinedMesh) -> Correlation:
    """Take a subdomain's pixels on its mesh refined, those of the cells alone that passes are confined to."""
    fine = _build_correlation(refined.mesh, rasterize(refined.mesh), whole.reference, whole.source, whole.threads)
    is_visited = np.zeros(whole.mesh.n_cells, dtype=bool)
    is_visited[whole.order] = True
    return fine.confine(is_visited[refined.parents])


def _build_correlation(mesh: Mesh, raster: Raster, image: GradientImage, source: MaskedSource,
                       threads: Threads) -> Correlation:
    """A subdomain whose cells are visited in bands of rows."""
    x, *others = mesh.centroids.T
    order = np.lexsort((x, *(along // VISITED_ROWS for along in others))).astype(np.int64)
    return Correlation(mesh, interpolate_cells(mesh), raster, image, source, order, threads)


def _without_band(mesh: Mesh, raster: Raster, image: GradientImage, degree: int) -> GradientImage:
    """The window of the reference image with the pixels near a discontinuity left out."""
    pixels, _ = find_band_pixels(mesh, raster, degree)
    if not len(pixels):
        return image
    near = np.zeros(image.values.shape, dtype=bool)
    near[pixels[:, 1] - image.window.y0, pixels[:, 0] - image.window.x0] = True
    return image.exclude(near)
