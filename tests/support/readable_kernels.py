"""What the pixel kernels compute, in plain loops over cells and pixels: M and b, Eq. 7 of [BP17], as they are written.

``READABLE`` takes the place of the kernels of ``pixel_kernels`` and of ``voxel_kernels`` and leaves the same numbers,
but for rounding, some ten thousand times more slowly. It is their explanation, and the oracle of their tests; no
measurement calls it.

Of every pixel x of a cell: its local coordinates (xi, eta), in a volume (xi, eta, zeta), the monomials phi, with which
the shape functions are N_a = sum_m T_am phi_m and the displacement is u = sum_m D_m phi_m, and g(x + u) by the spline.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, IntArray
from ddic.functionals.pixel_kernels import CellSums, PixelKernels, Shapes
from ddic.images.spline import GradientImage, SplineImage
from ddic.images.window import Window
from ddic.kinematics.cell_interpolation import CellInterpolation
from ddic.mesh.raster import Raster

NEWTON_STEPS = 30
"""Most steps towards a pixel's local coordinates; a convex cell takes five, one with a corner of nearly 180 degrees
twenty."""

_CLOSE = 1e-15
"""Last step of Newton's method, in local coordinates: rounding."""

DIFFERENCES = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
"""Weights of f(x + k) - f(x - k), k = 1 to 4, in the gradient of a volume."""


class Cells(NamedTuple):
    """Cells in the order of visiting, with the places of their nodes and their pixels."""

    order: IntArray
    interpolation: CellInterpolation
    raster: Raster


class Deformed(NamedTuple):
    """A window of g that holds all x + u(x) that lie in the image, and the box of the whole image."""

    spline: SplineImage
    extent: Window


@dataclass(frozen=True)
class Pixel:
    """A pixel of a cell.

    Attributes
    ----------
    place : (dim,) int64 array
        Column and row in the image, in a volume the plane as well.
    phi : (n_monomials,) array
        Monomials there.
    f : float
        Grey level of the reference image.
    slope : (dim,) array
        grad f, grey levels per pixel.
    counts : bool
        Whether the reference image does not exclude it.
    """

    place: IntArray
    phi: Array
    f: float
    slope: Array
    counts: bool


def sum_hessians(cells: Cells, shapes: Shapes, reference: GradientImage, out: Array) -> None:
    """Add M_e = sum_px N^T grad f grad f^T N of every cell, Eq. 7 of [BP17].

    ``out`` is (n_cells, n, dim, n, dim) by a, component, b, component; grey levels squared per pixel squared.
    """
    for e in cells.order:
        coefficients = shapes.coefficients[shapes.kinds[e]]
        for pixel in list_cell_pixels(cells, reference, e):
            if pixel.counts:
                N = coefficients @ pixel.phi
                # Entry (a, component) of N^T grad f.
                row = np.outer(N, pixel.slope)
                out[e] += np.multiply.outer(row, row)


def sum_residuals(cells: Cells, displacement: Array, reference: GradientImage, deformed: Deformed, all_kinds: bool,
                  sums: CellSums) -> None:
    """Add every cell's moments sum_px r grad f phi of the residual r = f - g(x + u), and its grey sums.

    b = sum_px N^T grad f r, Eq. 7 of [BP17], is a cell's first moment times its T. ``displacement`` holds D, (n_cells,
    dim, n_monomials), pixels. With ``all_kinds`` the moments of g and of 1, which a grey correction needs, are added.
    """
    for e in cells.order:
        for pixel in list_cell_pixels(cells, reference, e):
            g = evaluate_deformed(deformed, pixel, displacement[e])
            if g is None:
                continue
            r = pixel.f - g
            sums.grey[e] += [1.0, r, g, r**2, g**2, r * g]
            values = (r, g, 1.0) if all_kinds else (r,)
            for kind, value in enumerate(values):
                sums.moments[e, kind] += value * np.outer(pixel.slope, pixel.phi)


def write_residuals(cells: Cells, displacement: Array, reference: GradientImage, deformed: Deformed,
                    correction: Array, out: NDArray[np.float32]) -> None:
    """Write f - gain g(x + u) - offset of all cells' pixels.

    ``displacement`` and ``deformed`` are those of ``sum_residuals``. ``correction`` are gain, and offset in grey
    levels, of each cell, (2, n_cells). ``out`` has the reference window's shape, grey levels; NaN where a cell's
    pixel does not count.
    """
    gain, offset = correction
    for e in cells.order:
        for pixel in list_cell_pixels(cells, reference, e):
            g = evaluate_deformed(deformed, pixel, displacement[e])
            out[find_index(reference.window, pixel.place)] = np.nan if g is None else pixel.f - gain[e] * g - offset[e]


READABLE = PixelKernels(sum_hessians, sum_residuals, write_residuals, lambda f: f, Deformed, Cells)


def find_index(window: Window, place: IntArray) -> tuple[int, ...]:
    """Where a pixel is in an array of a window's pixels, whose axes run the other way round."""
    return tuple((place - window.lower)[::-1].tolist())


def list_cell_pixels(cells: Cells, f: GradientImage, e: int) -> Iterator[Pixel]:
    """Go through the pixels of a cell, row by row."""
    raster, geometry = cells.raster, cells.interpolation.geometry[e]
    runs, rows, _ = raster.find_runs(np.array([e]))
    around = f.window.grow(f.margin)
    for run, row in zip(runs, rows, strict=True):
        for x in range(raster.starts[run], raster.stops[run]):
            place = np.array([x, *row])
            index = find_index(f.window, place)
            counts = f.usable is None or f.usable[index] > 0
            phi = monomials(find_local_coordinates(geometry, place), geometry.shape[1])
            yield Pixel(place, phi, float(f.values[find_index(around, place)]), find_slope(f, place), bool(counts))


def find_slope(f: GradientImage, place: IntArray) -> Array:
    """Grad f at a pixel: that of its spline, in a volume differences of the grey levels on either side."""
    if f.margin == 0:
        return f.slopes[(slice(None), *find_index(f.window, place))].astype(np.float64)
    around, slope = f.window.grow(f.margin), np.zeros(len(place))
    for axis, unit in enumerate(np.eye(len(place), dtype=np.int64)):
        for k, weight in enumerate(DIFFERENCES, start=1):
            ahead, behind = (float(f.slopes[0][find_index(around, place + way * k * unit)]) for way in (1, -1))
            slope[axis] += weight * (ahead - behind)
    return slope


def monomials(local: Array, n_monomials: int) -> Array:
    """Evaluate (1, xi, eta, xi eta), or the first of (1, xi, eta, zeta, xi eta, xi zeta, eta zeta, xi eta zeta)."""
    if len(local) == 2:
        xi, eta = local
        return np.array([1.0, xi, eta, xi * eta])
    xi, eta, zeta = local
    return np.array([1.0, xi, eta, zeta, xi * eta, xi * zeta, eta * zeta, xi * eta * zeta])[:n_monomials]


def find_local_coordinates(geometry: Array, place: IntArray) -> Array:
    """Solve x = sum_m X_m phi_m(xi) by Newton's method for xi, (dim,), no unit.

    ``geometry`` holds X, the coefficients of the position on the monomials, (dim, n_monomials), pixels.
    """
    dim, n_monomials = geometry.shape
    local = np.zeros(dim)
    for _ in range(NEWTON_STEPS):
        gap = place - geometry @ monomials(local, n_monomials)
        # Monomials are linear in each coordinate: differences are their derivatives.
        by_local = np.column_stack([(monomials(local + unit, n_monomials) - monomials(local - unit, n_monomials)) / 2
                                    for unit in np.eye(dim)])
        step = np.linalg.solve(geometry @ by_local, gap)
        local = local + step
        if np.abs(step).max() <= _CLOSE:
            break
    return local


def evaluate_deformed(deformed: Deformed, pixel: Pixel, displacement: Array) -> float | None:
    """Evaluate g(x + u(x)) at a pixel; ``displacement`` holds D of its cell, (dim, n_monomials), pixels.

    None where the pixel does not count: f excludes it, x + u lies outside the image, or g excludes one of the pixels
    around x + u.
    """
    u = displacement @ pixel.phi
    last = np.array(deformed.extent.sizes) - 1
    is_inside = ((pixel.place + u >= 0.0) & (pixel.place + u <= last)).all()
    if not (pixel.counts and is_inside):
        return None
    # The pixel to the left of x + u and above it, and the rest: x + u itself would lose digits of u.
    corner = pixel.place + np.floor(u).astype(np.int64)
    usable = deformed.spline.usable
    if usable is not None and not usable[find_index(deformed.spline.window, corner)]:
        return None
    return evaluate_spline(deformed.spline, corner, u - np.floor(u))


def evaluate_spline(g: SplineImage, corner: IntArray, rest: Array) -> float:
    """Evaluate the spline sum_ij c_ij B(x - j) B(y - i), a grey level, between pixels.

    ``corner`` is the pixel to the left of the position and above it, from which ``rest`` leads to the position, 0 to 1
    along each axis, pixels.
    """
    # Pixels whose B-splines reach the position, from the one to the left of it and above it.
    taps = np.arange(-(g.degree // 2), g.degree // 2 + 2)
    weights = [np.array([evaluate_b_spline(t - k, g.degree) for k in taps]) for t in rest]
    # The array's first coefficient belongs to the pixel (degree + 1) / 2 to the left of the window and above it.
    first = find_index(g.window.grow((g.degree + 1) // 2), corner)
    coefficients = g.coefficients[np.ix_(*(at + taps for at in first))].astype(np.float64)
    value = (coefficients * reduce(np.multiply.outer, weights[::-1])).sum()
    return float(g.scale * value + g.offset)


def evaluate_b_spline(t: float, degree: int) -> float:
    """Evaluate the centred B-spline of a degree, degree + 1 boxes of width 1 convolved, by its recursion.

    ``t`` is the distance from its centre, pixels. Its values at all distances of a pixel sum to 1.
    """
    if degree == 0:
        return 1.0 if -0.5 <= t < 0.5 else 0.0
    half = (degree + 1) / 2
    left = (half + t) * evaluate_b_spline(t + 0.5, degree - 1)
    right = (half - t) * evaluate_b_spline(t - 0.5, degree - 1)
    return (left + right) / degree
