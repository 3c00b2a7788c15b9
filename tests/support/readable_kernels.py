"""What the pixel kernels compute, in plain loops over cells and pixels: M and b, Eq. 7 of [BP17], as they are written.

``READABLE`` takes the same arguments as the kernels of ``pixel_kernels`` and leaves the same numbers, but for rounding,
some ten thousand times more slowly. It is their explanation, and the oracle of their tests; no measurement calls it.

Of every pixel x of a cell: its local coordinates (xi, eta), the monomials phi = (1, xi, eta, xi eta), with which the
shape functions are N_a = sum_m T_am phi_m and the displacement is u = sum_m D_m phi_m, and g(x + u) by the spline.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array
from ddic.functionals.pixel_kernels import Cells, CellSums, DeformedPixels, PixelKernels, ReferencePixels, Shapes

NEWTON_STEPS = 30
"""Most steps towards a pixel's local coordinates; a convex cell takes five, one with a corner of nearly 180 degrees
twenty."""

_CLOSE = 1e-15
"""Last step of Newton's method, in local coordinates: rounding."""


@dataclass(frozen=True)
class Pixel:
    """A pixel of a cell.

    Attributes
    ----------
    x, y : int
        Column and row in the image.
    phi : (4,) array
        Monomials (1, xi, eta, xi eta) there.
    f : float
        Grey level of the reference image.
    slope : (2,) array
        grad f, grey levels per pixel.
    counts : bool
        Whether the reference image does not exclude it.
    """

    x: int
    y: int
    phi: Array
    f: float
    slope: Array
    counts: bool


def sum_hessians(cells: Cells, shapes: Shapes, reference: ReferencePixels, out: Array) -> None:
    """Add M_e = sum_px N^T grad f grad f^T N of every cell, Eq. 7 of [BP17].

    ``out`` is (n_cells, 4, 2, 4, 2) by a, component, b, component; grey levels squared per pixel squared.
    """
    for e in cells.order:
        coefficients = shapes.coefficients[shapes.kinds[e]]
        for pixel in list_cell_pixels(cells, reference, e):
            if pixel.counts:
                N = coefficients @ pixel.phi
                # Entry (a, component) of N^T grad f.
                row = np.outer(N, pixel.slope)
                out[e] += np.multiply.outer(row, row)


def sum_residuals(cells: Cells, displacement: Array, reference: ReferencePixels,
                  deformed: DeformedPixels, all_kinds: bool, sums: CellSums) -> None:
    """Add every cell's moments sum_px r grad f phi of the residual r = f - g(x + u), and its grey sums.

    b = sum_px N^T grad f r, Eq. 7 of [BP17], is a cell's first moment times its T. ``displacement`` holds D, (n_cells,
    2, 4), pixels; ``deformed`` is a window of g that holds all x + u(x) that lie in the image. With ``all_kinds`` the
    moments of g and of 1 are added too, which a grey correction needs.
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


def write_residuals(cells: Cells, displacement: Array, reference: ReferencePixels,
                    deformed: DeformedPixels, correction: Array,
                    out: NDArray[np.float32]) -> None:
    """Write f - gain g(x + u) - offset of all cells' pixels.

    ``displacement`` and ``deformed`` are those of ``sum_residuals``. ``correction`` are gain, and offset in grey
    levels, of each cell, (2, n_cells). ``out`` has the reference window's shape, grey levels; NaN where a cell's
    pixel does not count.
    """
    gain, offset = correction
    for e in cells.order:
        for pixel in list_cell_pixels(cells, reference, e):
            g = evaluate_deformed(deformed, pixel, displacement[e])
            place = (pixel.y - reference.y0, pixel.x - reference.x0)
            out[place] = np.nan if g is None else pixel.f - gain[e] * g - offset[e]


READABLE = PixelKernels(sum_hessians, sum_residuals, write_residuals)


def list_cell_pixels(cells: Cells, reference: ReferencePixels, e: int) -> Iterator[Pixel]:
    """Go through the pixels of a cell, row by row."""
    y = int(cells.first_row[e])
    for run in range(cells.row_ptr[e], cells.row_ptr[e + 1]):
        for x in range(cells.starts[run], cells.stops[run]):
            row, column = y - reference.y0, x - reference.x0
            place = row * reference.row_length + column
            slope = np.array([reference.by_x[place], reference.by_y[place]], dtype=np.float64)
            counts = reference.usable.size == 0 or reference.usable[row, column] > 0
            phi = monomials(*find_local_coordinates(cells.geometry[e], x, y))
            yield Pixel(x, y, phi, float(reference.values[place]), slope, bool(counts))
        y += 1


def monomials(xi: float, eta: float) -> Array:
    """Evaluate phi = (1, xi, eta, xi eta)."""
    return np.array([1.0, xi, eta, xi * eta])


def find_local_coordinates(geometry: Array, x: float, y: float) -> tuple[float, float]:
    """Solve (x, y) = sum_m X_m phi_m(xi, eta) by Newton's method for xi and eta, no unit.

    ``geometry`` holds X, the coefficients of the position on the monomials, (2, 4), pixels.
    """
    local = np.zeros(2)
    for _ in range(NEWTON_STEPS):
        xi, eta = local
        gap = np.array([x, y]) - geometry @ monomials(xi, eta)
        # d phi / d xi = (0, 1, 0, eta), d phi / d eta = (0, 0, 1, xi).
        by_local = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [eta, xi]])
        step = np.linalg.solve(geometry @ by_local, gap)
        local = local + step
        if np.abs(step).max() <= _CLOSE:
            break
    return float(local[0]), float(local[1])


def evaluate_deformed(deformed: DeformedPixels, pixel: Pixel, displacement: Array) -> float | None:
    """Evaluate g(x + u(x)) at a pixel; ``displacement`` holds D of its cell, (2, 4), pixels.

    None where the pixel does not count: f excludes it, x + u lies outside the image, or g excludes one of the four
    pixels around x + u.
    """
    ux, uy = displacement @ pixel.phi
    inside_x = 0.0 <= pixel.x + ux <= deformed.image_width - 1
    inside_y = 0.0 <= pixel.y + uy <= deformed.image_height - 1
    if not (pixel.counts and inside_x and inside_y):
        return None
    # The pixel to the left of x + u and above it, and the rest: x + u itself would lose digits of u.
    column, row = pixel.x + math.floor(ux), pixel.y + math.floor(uy)
    if deformed.usable.size > 0 and not deformed.usable[row - deformed.y0, column - deformed.x0]:
        return None
    return evaluate_spline(deformed, column, row, ux - math.floor(ux), uy - math.floor(uy))


def evaluate_spline(deformed: DeformedPixels, column: int, row: int, right: float, down: float) -> float:
    """Evaluate the spline sum_ij c_ij B(x - j) B(y - i), a grey level, between pixels.

    ``column`` and ``row`` are those of the pixel to the left of the position and above it; ``right`` and ``down`` lead
    from there to the position, 0 to 1, pixels.
    """
    degree = deformed.degree
    # Pixels whose B-splines reach the position, from the one to the left of it and above it.
    taps = np.arange(-(degree // 2), degree // 2 + 2)
    weights_x = np.array([evaluate_b_spline(right - j, degree) for j in taps])
    weights_y = np.array([evaluate_b_spline(down - i, degree) for i in taps])
    # The array's first coefficient belongs to the pixel (degree + 1) / 2 to the left of the window and above it.
    padding = (degree + 1) // 2
    rows = row + taps - deformed.y0 + padding
    columns = column + taps - deformed.x0 + padding
    coefficients = deformed.coefficients[rows[:, None] * deformed.row_length + columns].astype(np.float64)
    return float(weights_y @ coefficients @ weights_x)


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
