"""Whether a subdomain holds texture or no more than noise would give, and how far a field is out of equilibrium."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.arrays import Array, BoolArray, IntArray
from ddic.functionals.correlation import Correlation
from ddic.functionals.regularization import Material, assemble_stiffness
from ddic.images.spline import GradientImage
from ddic.mesh.mesh import Mesh
from ddic.mesh.quality import measure_areas
from ddic.mesh.topology import find_boundary_nodes

NOISE_GAIN = {3: 1.392305, 5: 1.893960}
"""Variance of the spline's slope at a pixel for white noise of variance 1: mean over w of |slope(w)/value(w)|^2 of the
degree's taps; 9 (2/sqrt(3) - 1) for the cubic."""

EMPTY = 1e-4
"""Energy relative to the largest subdomain's below which nothing is seen: gradients a hundred times weaker than those
of full-contrast speckle (tens of grey levels per pixel) are those of the rounding to 8 bit."""

NOISY = 2.0
"""Energy relative to that of noise below which it is no more than noise. White noise gives 0.6 to 1 (rotations weigh
the outer nodes, which see fewer pixels), speckle of a few pixels six and more."""

WEAK = 0.05
"""Energy relative to the textured subdomains' median above which it counts as texture, whatever its spectrum: grains
of one pixel look like noise too."""

ENOUGH_PIXELS = 200_000
"""Pixels of a subdomain on which its noise is estimated: the standard deviation is then known to half a per cent."""


@dataclass(frozen=True)
class Texture:
    """How well a subdomain's pixels hold it against rigid motion, the null space of its mechanics.

    Attributes
    ----------
    energy : float
        Least v^T M_s v / v^T v over rigid modes v, grey levels squared per pixel squared; none where the grey level
        varies in one direction only.
    noise : float
        What white noise as strong as the image's finest detail would give.
    """

    energy: float
    noise: float


def measure_texture(correlation: Correlation, hessian: sparse.csr_matrix, degree: int) -> Texture:
    """Measure a subdomain's texture, and that of noise, on the pixels that count.

    White noise of variance v gives every pixel's slopes the variance NOISE_GAIN v and holds all rigid modes alike: the
    sum over pixels of N_a N_b summed over nodes is 1, so that a translation of unit norm has the energy of the pixels'
    mean times their number over that of the nodes. ``hessian`` is the subdomain's M_s, grey levels squared per pixel
    squared, ``degree`` that of the spline, 3 or 5.
    """
    modes = np.linalg.qr(rigid_modes(correlation.mesh.nodes))[0]
    energies = np.linalg.eigvalsh(modes.T @ (hessian @ modes))
    slope_variance = NOISE_GAIN[degree] * _estimate_noise_variance(correlation)
    noise = slope_variance * correlation.n_usable_pixels / correlation.mesh.n_nodes
    return Texture(float(energies[0]), noise)


def _estimate_noise_variance(correlation: Correlation) -> float:
    """Estimate the variance of white noise as strong as the image's finest detail on the subdomain.

    J. Immerkaer's operator, Computer Vision and Image Understanding 64 (1996) 300-302, which texture can only raise, on
    rows enough for a good mean; pixels beside masked ones do not count. Grey levels squared; 0 without pixels.
    """
    f, raster = correlation.reference, correlation.raster
    step = max(1, f.window.n_pixels // ENOUGH_PIXELS)
    # Of a volume planes.
    rows = np.arange(1, f.window.shape[0] - 1, step)
    if min(f.window.sizes) < 3:
        return 0.0
    squares = _squared_details(f, rows)
    # Runs on those rows of the cells that have any; the window's outermost pixels have no detail.
    first = raster.first_rows[:, -1] - f.window.lower[-1]
    has_rows = np.searchsorted(rows, first) < np.searchsorted(rows, first + raster.n_rows[:, -1])
    runs, place, _ = raster.find_runs(np.flatnonzero(has_rows))
    place = place - f.window.lower[1:] - 1
    inside = ((place >= 0) & (place < np.subtract(f.window.sizes[1:], 2))).all(axis=1)
    kept = np.flatnonzero(inside & (place[:, -1] % step == 0))
    place = place[kept]
    place[:, -1] //= step
    run = np.ravel_multi_index(tuple(place.T[::-1]), squares.shape[:-1])
    starts, stops = (np.clip(ends[runs[kept]] - f.window.x0 - 1, 0, f.window.width - 2)
                     for ends in (raster.starts, raster.stops))
    n_pixels = float((stops - starts).sum())
    if f.usable is not None:
        counted = _with_usable_neighbours(f.usable, rows)
        squares *= counted
        n_pixels = _sum_runs(counted, run, starts, stops)
    total = _sum_runs(squares, run, starts, stops)
    return total / n_pixels if n_pixels else 0.0


def _squared_details(f: GradientImage, rows: IntArray) -> Array:
    """Squares of the finest detail on some rows of an image, or planes of a volume, without its outermost pixels."""
    # (1, -2, 1) / sqrt(6) along each axis is blind to curvature along one, and keeps the variance of white noise.
    values = f.grey_levels
    behind, on, ahead = (values[rows + k].astype(np.float32) for k in (-1, 0, 1))
    detail = behind - 2.0 * on + ahead
    for axis in range(1, values.ndim):
        behind, on, ahead = _shift_along(detail, axis)
        detail = behind - 2.0 * on + ahead
    detail = detail / 6.0 ** (values.ndim / 2)
    return np.asarray(detail.astype(np.float64) ** 2)


def _with_usable_neighbours(usable: NDArray[np.uint8], rows: IntArray) -> BoolArray:
    """Which pixels of some rows, or planes, without the outermost ones, are not excluded, nor are any beside."""
    counted = (usable[rows - 1] & usable[rows] & usable[rows + 1]) > 0
    for axis in range(1, usable.ndim):
        behind, on, ahead = _shift_along(counted, axis)
        counted = behind & on & ahead
    return np.asarray(counted)


def _shift_along(values: NDArray[Any], axis: int) -> tuple[NDArray[Any], ...]:
    """Values behind, on and ahead of each place along an axis, but for the first and the last one."""
    n_inside, before = values.shape[axis] - 2, (slice(None),) * axis
    return tuple(values[(*before, slice(k, k + n_inside))] for k in range(3))


def _sum_runs(values: NDArray[Any], row: IntArray, start: IntArray, stop: IntArray) -> float:
    """Sum of values (..., width) over runs of columns start to stop - 1; rows are numbered over all axes before."""
    values = values.reshape(-1, values.shape[-1])
    up_to = np.zeros((values.shape[0], values.shape[1] + 1))
    np.cumsum(values, axis=1, out=up_to[:, 1:])
    return float((up_to[row, stop] - up_to[row, start]).sum())


def rigid_modes(nodes: Array) -> Array:
    """Build translations, then infinitesimal rotations about the centre.

    A mode a column, (n dim, dim (dim + 1) / 2), node-major; rotations, as the nodes' positions, in pixels.
    """
    n, dim = nodes.shape
    centred = nodes - nodes.mean(axis=0)
    modes = [np.tile(row, (n, 1)) for row in np.eye(dim)]
    for a in range(dim):
        for b in range(a + 1, dim):
            rotation = np.zeros((n, dim))
            rotation[:, a] = -centred[:, b]
            rotation[:, b] = centred[:, a]
            modes.append(rotation)
    return np.stack([mode.ravel() for mode in modes], axis=1)


def find_blank_subdomains(textures: Sequence[Texture]) -> BoolArray:
    """Find the subdomains, or pieces of them, that hold no usable texture.

    True where there is nothing, or where there is no more than noise and little beside what others have: all of the
    region must be given.
    """
    energy = np.array([t.energy for t in textures])
    noise = np.array([t.noise for t in textures])
    empty = energy <= EMPTY * energy.max()
    noisy = energy <= NOISY * noise
    textured = ~empty & ~noisy
    if not textured.any():
        return np.asarray(empty)
    weak = energy <= WEAK * np.median(energy[textured])
    return np.asarray(empty | noisy & weak)


def measure_gap(mesh: Mesh, displacement: Array, material: Material) -> float:
    """Measure the RMS of div s over Young's modulus: K u at interior nodes, each over its share of the area.

    1/px, alike for elements of any size; nan where no node counts. The displacement is (n_nodes, dim), pixels; nodes
    about which one has none do not count.
    """
    stiffness = assemble_stiffness(mesh, material)
    forces = (stiffness @ displacement.ravel()).reshape(displacement.shape)
    is_interior = np.ones(mesh.n_nodes, dtype=bool)
    is_interior[find_boundary_nodes(mesh)] = False
    counts = is_interior & np.isfinite(forces).all(axis=1)
    if not counts.any():
        return float("nan")
    n_corners = np.diff(mesh.offsets)
    shares = np.repeat(np.abs(measure_areas(mesh)) / n_corners, n_corners)
    areas = np.bincount(mesh.connectivity, shares, minlength=mesh.n_nodes)
    return float(np.sqrt((forces[counts] ** 2 / areas[counts, None] ** 2).mean()))
