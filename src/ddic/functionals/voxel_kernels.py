"""Compiled loops over the voxels of cells, fused with the assembly of cell sums.

``tests/support/readable_kernels.py`` says the same in plain loops, voxel by voxel: read it first, it is the oracle of
this file.

Voxels of a cell are visited row by row, along x, eight at a time. In a tetrahedron, and in a hexahedron whose sides lie
along the axes, the displacement is linear along a row; in other hexahedra local coordinates are found by Newton's
method, of eight voxels at once. Voxels whose displacements have one integer part read spline coefficients
contiguously; where it changes, the next voxels begin anew. Displacements are split into an integer part and a fraction,
so that no digit is lost to the position in the volume. Grey levels and splines are float32, all sums float64.

The gradient of f is taken from its grey levels when it is needed, by differences of eighth order, which spares three
numbers a voxel: 0.2 % too small for waves of 6 voxels.

The stages share this file because numba's cache of a kernel does not notice changes in other files.
"""
# mypy: disable-error-code="no-untyped-def, assignment"

import math
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, IntArray
from ddic.functionals.pixel_kernels import FLAGS, INLINED, N_SUMS, CellSums, PixelKernels, count_step, flatten
from ddic.images import volume
from ddic.images.spline import PADDING, GradientImage, SplineImage
from ddic.images.window import Window
from ddic.kinematics.cell_interpolation import CellInterpolation
from ddic.mesh.raster import Raster
from ddic.vectors import (
    WIDTH,
    count,
    count_equal,
    fill,
    fill_wide,
    load,
    mark_first,
    round_down,
    store,
    sum_lanes,
    take_first,
    widen,
)

DIFFERENCES = tuple(np.float32(weight) for weight in volume.DIFFERENCES)
"""Weights of f(x + k) - f(x - k), k = 1 to 4."""

AFFINE = 1e-11
"""A cell whose mixed terms are below this, relative to its linear ones, is affine but for rounding."""

NEWTON_STEPS, CLOSE = 8, 1e-4
"""Most steps towards local coordinates, and the step after which the next one would be below float32's rounding."""

FAR = (3.0 * 1.5**2)**4
"""Fourth power of the square of a distance from the centre, local coordinates, at which no voxel of a cell is."""

BARELY = 1.0 + 1e-6
"""A position in the volume by less than this, relative to its size, is looked at in float64."""


class _Cells(NamedTuple):
    """Cells of a mesh and the voxels of each.

    Attributes
    ----------
    order : (n_visited,) int64 array
        Cells in the order of visiting.
    geometry : (n_cells, 3, 4 or 8) float64 array
        Coefficients of (x, y, z) on the monomials, voxels.
    n_monomials : (n_cells,) int64 array
        How many of them each cell's shape functions have: 4 of a tetrahedron.
    first_rows, n_rows, row_ptr, starts, stops : arrays
        Their runs of voxels, as ``Raster`` has them.
    """

    order: IntArray
    geometry: Array
    n_monomials: IntArray
    first_rows: IntArray
    n_rows: IntArray
    row_ptr: IntArray
    starts: NDArray[np.int32]
    stops: NDArray[np.int32]


class ReferenceVoxels(NamedTuple):
    """A box of the reference volume f, and the voxels about it that its gradient is taken from.

    Attributes
    ----------
    values, differentiated : (n,) uint8, uint16 or float32 arrays
        Rows, one after the other, plane by plane: grey levels, and those that the gradient is taken from.
    row_length, plane_length : int
        Numbers from one row to the next, and from one plane.
    origin : int
        Where voxel (0, 0, 0) is, or would be.
    usable : (depth, height, width) uint8 array
        0 where a voxel is excluded; (0, 0, 0) where none is, so that there is one compiled kernel for both.
    lower : (3,) int64 array
        The box's first voxel.
    """

    values: NDArray[Any]
    differentiated: NDArray[Any]
    row_length: int
    plane_length: int
    origin: int
    usable: NDArray[np.uint8]
    lower: IntArray


class DeformedVoxels(NamedTuple):
    """A box of the deformed volume g as coefficients of a cubic spline, and those about it that the spline needs.

    Attributes
    ----------
    coefficients : (n,) int16 or float32 array
        Rows, one after the other, plane by plane; a vector may be loaded beyond their end.
    row_length, plane_length : int
        Numbers from one row to the next, and from one plane.
    origin : int
        Where the coefficient of voxel (0, 0, 0) is, or would be.
    scale, offset : float
        Grey levels are scale times the spline of the coefficients, plus offset.
    usable : (depth, height, width) uint8 array
        0 where g between the voxel and the next one along each axis is interpolated from an excluded one; (0, 0, 0)
        where nothing is excluded.
    lower : (3,) int64 array
        The box's first voxel.
    sizes : (3,) int64 array
        Numbers of voxels of the whole volume along x, y and z.
    """

    coefficients: NDArray[Any]
    row_length: int
    plane_length: int
    origin: int
    scale: float
    offset: float
    usable: NDArray[np.uint8]
    lower: IntArray
    sizes: IntArray


class _Row(NamedTuple):
    """Voxels of a cell in a row: columns x to before stop."""

    x: Any
    stop: Any
    y: Any
    z: Any


class _Run(NamedTuple):
    """Neighbouring voxels of a row, at most a vector, whose displacements have one integer part.

    x, n: the first one's column, and how many they are; i, j, k: the integer parts along x, y and z; weight: 0 if they
    are displaced out of the volume, else 1.
    """

    x: Any
    n: Any
    i: Any
    j: Any
    k: Any
    weight: Any


class _Scratch(NamedTuple):
    """Of one cell.

    Attributes
    ----------
    inverse : (3, 3) array
        d(xi, eta, zeta) / d(x, y, z) of an affine cell, or of another at its centre.
    phi, slope : (8,) array
        Monomials at the first voxel of a row, and what they grow by from one voxel to the next.
    lanes : (8 x WIDTH,) float32 array
        Monomials of neighbouring voxels.
    weights, drawn : (WIDTH,) float32 array
        Which of neighbouring voxels count; what is written of them.
    moments : (9 x 8,) array
        Those of a cell that is linear along rows, of each kind and component; zeros between cells.
    sums, grey, pairs : (n x WIDTH,) array
        Moments, grey sums, and sums of grad f grad f^T times products of two monomials, by lanes; zeros between cells.
    products, half : (6 x 8 x 8,) and (8, 8) array
        The last ones added up, and half of the way from monomials to shape functions.
    """

    inverse: Array
    phi: Array
    slope: Array
    lanes: NDArray[np.float32]
    weights: NDArray[np.float32]
    drawn: NDArray[np.float32]
    moments: Array
    sums: Array
    grey: Array
    pairs: Array
    products: Array
    half: Array


@numba.njit(**FLAGS)
def _new_scratch():
    return _Scratch(np.zeros((3, 3)), np.zeros(8), np.zeros(8), np.zeros(8 * WIDTH, np.float32),
                    np.zeros(WIDTH, np.float32), np.zeros(WIDTH, np.float32), np.zeros(9 * 8), np.zeros(72 * WIDTH),
                    np.zeros(N_SUMS * WIDTH), np.zeros(216 * WIDTH), np.zeros(6 * 8 * 8), np.zeros((8, 8)))


@numba.njit(**INLINED)
def _cubic_weights(t):
    """Weights of the four coefficients about a fraction t of a voxel."""
    one = fill(1.0)
    u = one - t
    w0, w3 = u * u * u * fill(1 / 6), t * t * t * fill(1 / 6)
    w1 = fill(2 / 3) - fill(0.5) * t * t * (one + u)
    # The last weight is what the others leave to 1, so that constants are kept to rounding.
    return w0, w1, one - w0 - w1 - w3, w3


@numba.njit(**INLINED)
def _along_row(c, at, x):
    return x[0] * load(c, at) + x[1] * load(c, at + 1) + x[2] * load(c, at + 2) + x[3] * load(c, at + 3)


@numba.njit(**INLINED)
def _in_plane(c, at, row, x, y):
    return (y[0] * _along_row(c, at, x) + y[1] * _along_row(c, at + row, x)
            + y[2] * _along_row(c, at + 2 * row, x) + y[3] * _along_row(c, at + 3 * row, x))


@numba.njit(**INLINED)
def _evaluate_spline(deformed, at, t_x, t_y, t_z):
    """Evaluate g at fractions of a voxel from neighbouring ones, the first of which is at a place."""
    c, row, plane = deformed.coefficients, deformed.row_length, deformed.plane_length
    x, y, z = _cubic_weights(t_x), _cubic_weights(t_y), _cubic_weights(t_z)
    at -= 1 + row + plane
    value = (z[0] * _in_plane(c, at, row, x, y) + z[1] * _in_plane(c, at + plane, row, x, y)
             + z[2] * _in_plane(c, at + 2 * plane, row, x, y) + z[3] * _in_plane(c, at + 3 * plane, row, x, y))
    return fill(deformed.scale) * value + fill(deformed.offset)


@numba.njit(**INLINED)
def _differentiate(f, at, step):
    """Differentiate f at neighbouring voxels along the axis whose next voxel is a step away."""
    return (fill(DIFFERENCES[0]) * (load(f, at + step) - load(f, at - step))
            + fill(DIFFERENCES[1]) * (load(f, at + 2 * step) - load(f, at - 2 * step))
            + fill(DIFFERENCES[2]) * (load(f, at + 3 * step) - load(f, at - 3 * step))
            + fill(DIFFERENCES[3]) * (load(f, at + 4 * step) - load(f, at - 4 * step)))


@numba.njit(**INLINED)
def _find_gradient(reference, at):
    """Grad f at neighbouring voxels."""
    f = reference.differentiated
    return (_differentiate(f, at, 1), _differentiate(f, at, reference.row_length),
            _differentiate(f, at, reference.plane_length))


@numba.njit(**INLINED)
def _is_linear(geometry, n_monomials, e, inverse):
    """Whether monomials of shape functions are linear along rows of cell e; d xi / dx is left in ``inverse``."""
    X = geometry
    a, b, c = X[e, 0, 1], X[e, 0, 2], X[e, 0, 3]
    d, f, g = X[e, 1, 1], X[e, 1, 2], X[e, 1, 3]
    h, i, j = X[e, 2, 1], X[e, 2, 2], X[e, 2, 3]
    det = a * (f * j - g * i) - b * (d * j - g * h) + c * (d * i - f * h)
    inverse[0, 0], inverse[0, 1], inverse[0, 2] = (f * j - g * i) / det, (c * i - b * j) / det, (b * g - c * f) / det
    inverse[1, 0], inverse[1, 1], inverse[1, 2] = (g * h - d * j) / det, (a * j - c * h) / det, (c * d - a * g) / det
    inverse[2, 0], inverse[2, 1], inverse[2, 2] = (d * i - f * h) / det, (b * h - a * i) / det, (a * f - b * d) / det
    mixed, linear = 0.0, 0.0
    for component in range(3):
        for m in range(1, 4):
            linear += abs(X[e, component, m])
        for m in range(4, n_monomials):
            mixed += abs(X[e, component, m])
    across = abs(inverse[1, 0]) + abs(inverse[2, 0])
    return mixed <= AFFINE * linear and (n_monomials == 4 or across <= AFFINE * abs(inverse[0, 0]))


@numba.njit(**INLINED)
def _begin_row(geometry, e, row, scratch):
    """Find monomials at the first voxel of a row of a cell that is linear along it, and their growth.

    Gives local coordinates there, and their growth.
    """
    X, G, phi, slope = geometry, scratch.inverse, scratch.phi, scratch.slope
    x, y, z = row.x - X[e, 0, 0], row.y - X[e, 1, 0], row.z - X[e, 2, 0]
    xi = G[0, 0] * x + G[0, 1] * y + G[0, 2] * z
    eta = G[1, 0] * x + G[1, 1] * y + G[1, 2] * z
    zeta = G[2, 0] * x + G[2, 1] * y + G[2, 2] * z
    phi[0], phi[1], phi[2], phi[3] = 1.0, xi, eta, zeta
    phi[4], phi[5], phi[6], phi[7] = xi * eta, xi * zeta, eta * zeta, xi * eta * zeta
    a, b, c = G[0, 0], G[1, 0], G[2, 0]
    slope[0], slope[1], slope[2], slope[3] = 0.0, a, b, c
    # Where rows are not along xi, shape functions have no mixed terms, and those below meet zeros.
    slope[4], slope[5], slope[6], slope[7] = a * eta, a * zeta, 0.0, a * eta * zeta
    return xi, eta, zeta, a, b, c


@numba.njit(**INLINED)
def _evaluate(X, n_monomials, e, i, xi, eta, zeta):
    """A component of sum_m X_m phi_m."""
    value = X[e, i, 0] + X[e, i, 1] * xi + X[e, i, 2] * eta + X[e, i, 3] * zeta
    if n_monomials > 4:
        value += (X[e, i, 4] + X[e, i, 7] * zeta) * xi * eta + (X[e, i, 5] * xi + X[e, i, 6] * eta) * zeta
    return value


@numba.njit(**INLINED)
def _displace_row(D, n_monomials, e, i, start):
    """Displacement of a row's first voxel along an axis, and its growth from one voxel to the next."""
    xi, eta, zeta, a, b, c = start
    growth = D[e, i, 1] * a + D[e, i, 2] * b + D[e, i, 3] * c
    if n_monomials > 4:
        growth += (D[e, i, 4] * eta + (D[e, i, 5] + D[e, i, 7] * eta) * zeta) * a
    return _evaluate(D, n_monomials, e, i, xi, eta, zeta), growth


@numba.njit(**INLINED)
def _count_together(t_x, t_y, t_z, du, dv, dw, n):
    """How many of n voxels of a row have displacements of one integer part: t are the first one's fractions."""
    for last in range(n - 1, 0, -1):
        if 0.0 <= t_x + du * last < 1.0 and 0.0 <= t_y + dv * last < 1.0 and 0.0 <= t_z + dw * last < 1.0:
            return last + 1
    return 1


@numba.njit(**INLINED)
def _is_inside(sizes, x, y, z):
    """Whether a position lies in the volume; one that is not a number does not."""
    return (0.0 <= x <= sizes[0] - 1.0) and (0.0 <= y <= sizes[1] - 1.0) and (0.0 <= z <= sizes[2] - 1.0)


@numba.njit(**INLINED)
def _clamp(x, size):
    """The position in the volume that is nearest, 0 for one that is not a number."""
    x = x if x > 0.0 else 0.0
    return min(x, size - 1.0)


@numba.njit(**INLINED)
def _stays_inside(geometry, displacement, n_monomials, e, sizes):
    """Whether all displaced voxels of a cell certainly lie in the volume."""
    inside = True
    for corner in range(8):
        xi, eta, zeta = 2.0 * (corner & 1) - 1.0, 1.0 * (corner & 2) - 1.0, 0.5 * (corner & 4) - 1.0
        for i in range(3):
            at = (_evaluate(geometry, n_monomials, e, i, xi, eta, zeta)
                  + _evaluate(displacement, n_monomials, e, i, xi, eta, zeta))
            inside = inside and (1.0 <= at <= sizes[i] - 2.0)
    return inside


@numba.njit(**INLINED)
def _place_alone(deformed, row, x, u, v, w):
    """Displacement of one voxel that may leave the volume, else to the nearest position in it; its weight, 1 or 0."""
    sizes = deformed.sizes
    if _is_inside(sizes, x + u, row.y + v, row.z + w):
        return u, v, w, 1.0
    return (_clamp(x + u, sizes[0]) - x, _clamp(row.y + v, sizes[1]) - row.y, _clamp(row.z + w, sizes[2]) - row.z, 0.0)


@numba.njit(**INLINED)
def _weigh(usable, lower, x, y, z, n, scratch):
    """Leave out of n neighbouring voxels, the first of which is given, those that are excluded."""
    weights = scratch.weights
    for lane in range(n):
        weights[lane] = usable[z - lower[2], y - lower[1], x + lane - lower[0]]
    return load(weights, 0)


@numba.njit(**INLINED)
def _count_voxels(reference, row, x, n, scratch):
    """1 for each of n neighbouring voxels of a row, from x on, that counts in the reference volume, else 0."""
    counts = mark_first(n)
    if reference.usable.size > 0:
        counts = counts * _weigh(reference.usable, reference.lower, x, row.y, row.z, n, scratch)
    return counts


@numba.njit(**INLINED)
def _find_place(volume, x, y, z):
    """Where a voxel is in the flat array of a volume's box."""
    return z * volume.plane_length + y * volume.row_length + x + volume.origin


@numba.njit(**INLINED)
def _compare(reference, deformed, row, run, t_x, t_y, t_z, scratch):
    """For a run of voxels: whether they count, f - g and g, which are 0 where they do not.

    t are the fractions of their displacements.
    """
    counts = _count_voxels(reference, row, run.x, run.n, scratch) * fill(run.weight)
    x, y, z = run.x + run.i, row.y + run.j, row.z + run.k
    if deformed.usable.size > 0:
        counts = counts * _weigh(deformed.usable, deformed.lower, x, y, z, run.n, scratch)
    g = counts * _evaluate_spline(deformed, _find_place(deformed, x, y, z), t_x, t_y, t_z)
    return counts, counts * load(reference.values, _find_place(reference, run.x, row.y, row.z)) - g, g


@numba.njit(**INLINED)
def _draw(reference, e, row, run, counts, r, g, correction, scratch, out):
    """Write f - gain g - offset of a run of voxels, NaN where one does not count."""
    # r is f - g where it counts.
    store(scratch.drawn, 0, r + (fill(1.0) - fill(correction[0, e])) * g - fill(correction[1, e]))
    store(scratch.weights, 0, counts)
    lower = reference.lower
    for lane in range(run.n):
        value = scratch.drawn[lane] if scratch.weights[lane] > 0.0 else np.float32(np.nan)
        out[row.z - lower[2], row.y - lower[1], run.x + lane - lower[0]] = value


@numba.njit(**INLINED)
def _add_at(sums, place, value):
    """Add a vector to a sum by lanes."""
    at = place * WIDTH
    store(sums, at, load(sums, at) + value)


@numba.njit(**INLINED)
def _total_at(sums, place):
    """A sum over all lanes, which become 0."""
    at = place * WIDTH
    value = sum_lanes(load(sums, at))
    store(sums, at, widen(fill(0.0)))
    return value


@numba.njit(**INLINED)
def _add_grey(sums, counts, r, g):
    """Add neighbouring voxels to sums of (1, r, g, r^2, g^2, r g), by lanes."""
    r, g = widen(r), widen(g)
    _add_at(sums, 0, widen(counts))
    _add_at(sums, 1, r)
    _add_at(sums, 2, g)
    _add_at(sums, 3, r * r)
    _add_at(sums, 4, g * g)
    _add_at(sums, 5, r * g)


@numba.njit(**INLINED)
def _add_row_moments(sums, kind, value, gradient, from_begin):
    """Add neighbouring voxels to sums of value times grad f, and of the same times the place in the row, by lanes."""
    a, b, c = widen(value * gradient[0]), widen(value * gradient[1]), widen(value * gradient[2])
    first = 6 * kind
    _add_at(sums, first, a)
    _add_at(sums, first + 1, a * from_begin)
    _add_at(sums, first + 2, b)
    _add_at(sums, first + 3, b * from_begin)
    _add_at(sums, first + 4, c)
    _add_at(sums, first + 5, c * from_begin)


@numba.njit(**INLINED)
def _visit_linear_row(cells, displacement, reference, deformed, e, row, inside, scratch, n_kinds, correction, out):
    """Add a row of a cell whose monomials are linear along it to the cell's moments and sums, or draw its residual."""
    start, n_monomials = _begin_row(cells.geometry, e, row, scratch), cells.n_monomials[e]
    u0, du = _displace_row(displacement, n_monomials, e, 0, start)
    v0, dv = _displace_row(displacement, n_monomials, e, 1, start)
    w0, dw = _displace_row(displacement, n_monomials, e, 2, start)
    x = row.x
    while x < row.stop:
        step = x - row.x
        u, v, w, weight = u0 + du * step, v0 + dv * step, w0 + dw * step, 1.0
        n = min(row.stop - x, WIDTH)
        if not inside:
            last, sizes = n - 1, deformed.sizes
            if not (_is_inside(sizes, x + u, row.y + v, row.z + w)
                    and _is_inside(sizes, x + u + (1 + du) * last, row.y + v + dv * last, row.z + w + dw * last)):
                n = 1
                u, v, w, weight = _place_alone(deformed, row, x, u, v, w)
        i, j, k = math.floor(u), math.floor(v), math.floor(w)
        n = _count_together(u - i, v - j, w - k, du, dv, dw, n)
        run, places = _Run(x, n, np.int64(i), np.int64(j), np.int64(k), weight), count()
        counts, r, g = _compare(reference, deformed, row, run, fill(u - i) + places * fill(du),
                                fill(v - j) + places * fill(dv), fill(w - k) + places * fill(dw), scratch)
        x += n
        if out.size > 0:
            _draw(reference, e, row, run, counts, r, g, correction, scratch, out)
            continue
        gradient = _find_gradient(reference, _find_place(reference, run.x, row.y, row.z))
        from_begin = widen(places + fill(1.0 * step))
        _add_grey(scratch.grey, counts, r, g)
        _add_row_moments(scratch.sums, 0, r, gradient, from_begin)
        if n_kinds > 1:
            _add_row_moments(scratch.sums, 1, g, gradient, from_begin)
            _add_row_moments(scratch.sums, 2, counts, gradient, from_begin)
    if out.size > 0:
        return
    phi, slope = load(scratch.phi, 0), load(scratch.slope, 0)
    for place in range(3 * n_kinds):
        value, along = _total_at(scratch.sums, 2 * place), _total_at(scratch.sums, 2 * place + 1)
        _add_at(scratch.moments, place, fill_wide(value) * phi + fill_wide(along) * slope)


@numba.njit(**INLINED)
def _add_up(X, e, i, xi, eta, zeta):
    """A component of sum_m X_m phi_m, but for its constant."""
    return (xi * (fill(X[e, i, 1]) + eta * (fill(X[e, i, 4]) + zeta * fill(X[e, i, 7])) + zeta * fill(X[e, i, 5]))
            + eta * (fill(X[e, i, 2]) + zeta * fill(X[e, i, 6])) + zeta * fill(X[e, i, 3]))


@numba.njit(**INLINED)
def _find_slopes(X, e, i, xi, eta, zeta):
    """Derivatives of a component of sum_m X_m phi_m by xi, eta and zeta."""
    mixed = fill(X[e, i, 7])
    by_xi = fill(X[e, i, 1]) + eta * fill(X[e, i, 4]) + zeta * (fill(X[e, i, 5]) + eta * mixed)
    by_eta = fill(X[e, i, 2]) + xi * fill(X[e, i, 4]) + zeta * (fill(X[e, i, 6]) + xi * mixed)
    by_zeta = fill(X[e, i, 3]) + xi * fill(X[e, i, 5]) + eta * (fill(X[e, i, 6]) + xi * mixed)
    return by_xi, by_eta, by_zeta


@numba.njit(**INLINED)
def _find_local_coordinates(X, e, inverse, x, y, z):
    """Invert x = X phi(xi, eta, zeta) at neighbouring voxels by Newton's method; x, y, z are from the cell's centre.

    And whether these were found: in a cell that is badly distorted they may not be.
    """
    G = inverse
    xi = fill(G[0, 0]) * x + fill(G[0, 1] * y + G[0, 2] * z)
    eta = fill(G[1, 0]) * x + fill(G[1, 1] * y + G[1, 2] * z)
    zeta = fill(G[2, 0]) * x + fill(G[2, 1] * y + G[2, 2] * z)
    for _ in range(NEWTON_STEPS):
        p = _add_up(X, e, 0, xi, eta, zeta) - x
        q = _add_up(X, e, 1, xi, eta, zeta) - fill(y)
        r = _add_up(X, e, 2, xi, eta, zeta) - fill(z)
        a, b, c = _find_slopes(X, e, 0, xi, eta, zeta)
        d, f, g = _find_slopes(X, e, 1, xi, eta, zeta)
        h, i, j = _find_slopes(X, e, 2, xi, eta, zeta)
        fj, dj, di = f * j - g * i, g * h - d * j, d * i - f * h
        reciprocal = fill(1.0) / (a * fj + b * dj + c * di)
        d_xi = (fj * p + (c * i - b * j) * q + (b * g - c * f) * r) * reciprocal
        d_eta = (dj * p + (a * j - c * h) * q + (c * d - a * g) * r) * reciprocal
        d_zeta = (di * p + (b * h - a * i) * q + (a * f - b * d) * r) * reciprocal
        xi, eta, zeta = xi - d_xi, eta - d_eta, zeta - d_zeta
        if sum_lanes(d_xi * d_xi + d_eta * d_eta + d_zeta * d_zeta) <= CLOSE * CLOSE:
            break
    square = xi * xi + eta * eta + zeta * zeta
    square = square * square
    return xi, eta, zeta, sum_lanes(square * square) <= FAR


@numba.njit(**INLINED)
def _place_curved(X, e, row, x, n, scratch):
    """Local coordinates of n neighbouring voxels, at most a vector; their monomials are left in ``scratch.lanes``.

    And whether they count: those whose coordinates are not found are taken for the cell's centre, and do not.
    """
    counts = mark_first(n)
    # Beyond the last one it is repeated: nothing is known of what lies outside the cell.
    places = counts * count() + (fill(1.0) - counts) * fill(n - 1)
    xi, eta, zeta, is_found = _find_local_coordinates(X, e, scratch.inverse, places + fill(x - X[e, 0, 0]),
                                                      row.y - X[e, 1, 0], row.z - X[e, 2, 0])
    if not is_found:
        xi, eta, zeta = fill(0.0), fill(0.0), fill(0.0)
    lanes, xi_eta = scratch.lanes, xi * eta
    store(lanes, 0, fill(1.0))
    store(lanes, WIDTH, xi)
    store(lanes, 2 * WIDTH, eta)
    store(lanes, 3 * WIDTH, zeta)
    store(lanes, 4 * WIDTH, xi_eta)
    store(lanes, 5 * WIDTH, xi * zeta)
    store(lanes, 6 * WIDTH, eta * zeta)
    store(lanes, 7 * WIDTH, xi_eta * zeta)
    return xi, eta, zeta, is_found


@numba.njit(**INLINED)
def _count_inside(size, places):
    """How many neighbouring voxels, from the first on, certainly are in the volume at these places along an axis."""
    return count_equal(round_down(places * fill(BARELY / (size - 1.0))), fill(0.0))


@numba.njit(**INLINED)
def _visit_curved_row(cells, displacement, reference, deformed, e, row, inside, scratch, n_kinds, correction, out):
    """Add a row of any hexahedron to moments and grey sums by lanes, or draw its residual."""
    X, D, lanes, sizes = cells.geometry, displacement, scratch.lanes, deformed.sizes
    base_u, base_v, base_w = math.floor(D[e, 0, 0]), math.floor(D[e, 1, 0]), math.floor(D[e, 2, 0])
    x = row.x
    while x < row.stop:
        n = min(row.stop - x, WIDTH)
        xi, eta, zeta, is_found = _place_curved(X, e, row, x, n, scratch)
        weight = 1.0 if is_found else 0.0
        u = _add_up(D, e, 0, xi, eta, zeta) + fill(D[e, 0, 0] - base_u)
        v = _add_up(D, e, 1, xi, eta, zeta) + fill(D[e, 1, 0] - base_v)
        w = _add_up(D, e, 2, xi, eta, zeta) + fill(D[e, 2, 0] - base_w)
        if not inside:
            n_inside = min(_count_inside(sizes[0], u + count() + fill(x + base_u)),
                           _count_inside(sizes[1], v + fill(row.y + base_v)),
                           _count_inside(sizes[2], w + fill(row.z + base_w)))
            n = min(n, max(n_inside, 1))
            if n_inside == 0:
                alone_u, alone_v, alone_w, is_inside = _place_alone(deformed, row, x, take_first(u) + base_u,
                                                                    take_first(v) + base_v, take_first(w) + base_w)
                u, v, w = fill(alone_u - base_u), fill(alone_v - base_v), fill(alone_w - base_w)
                weight *= is_inside
        i, j, k = round_down(u), round_down(v), round_down(w)
        first_i, first_j, first_k = take_first(i), take_first(j), take_first(k)
        n = min(n, count_equal(i, fill(first_i)), count_equal(j, fill(first_j)), count_equal(k, fill(first_k)))
        run = _Run(x, n, np.int64(first_i) + np.int64(base_u), np.int64(first_j) + np.int64(base_v),
                   np.int64(first_k) + np.int64(base_w), weight)
        counts, r, g = _compare(reference, deformed, row, run, u - i, v - j, w - k, scratch)
        x += n
        if out.size > 0:
            _draw(reference, e, row, run, counts, r, g, correction, scratch, out)
            continue
        f_x, f_y, f_z = _find_gradient(reference, _find_place(reference, run.x, row.y, row.z))
        _add_grey(scratch.grey, counts, r, g)
        for kind in range(n_kinds):
            value = r
            if kind == 1:
                value = g
            elif kind == 2:
                value = counts
            a, b, c = value * f_x, value * f_y, value * f_z
            for m in range(8):
                phi = load(lanes, m * WIDTH)
                _add_at(scratch.sums, 24 * kind + m, widen(a * phi))
                _add_at(scratch.sums, 24 * kind + 8 + m, widen(b * phi))
                _add_at(scratch.sums, 24 * kind + 16 + m, widen(c * phi))


@numba.njit(**INLINED)
def _find_row(cells, e, run):
    """The voxels of a run of cell e."""
    n_y, n_z = cells.n_rows[e, 0], cells.n_rows[e, 1]
    k = run - cells.row_ptr[e]
    return _Row(np.int64(cells.starts[run]), np.int64(cells.stops[run]), cells.first_rows[e, 0] + k % n_y,
                cells.first_rows[e, 1] + k // n_y % n_z)


@numba.njit(**FLAGS)
def _visit(cells, displacement, reference, deformed, sums, correction, out):
    """Sum the residual of all cells, or draw it where there is an image to draw on."""
    scratch = _new_scratch()
    n_kinds = sums.moments.shape[1]
    for visit in range(len(cells.order)):
        e = cells.order[visit]
        is_linear = _is_linear(cells.geometry, cells.n_monomials[e], e, scratch.inverse)
        inside = _stays_inside(cells.geometry, displacement, cells.n_monomials[e], e, deformed.sizes)
        for run in range(cells.row_ptr[e], cells.row_ptr[e + 1]):
            row = _find_row(cells, e, run)
            if row.x >= row.stop:
                continue
            if is_linear:
                _visit_linear_row(cells, displacement, reference, deformed, e, row, inside, scratch, n_kinds,
                                  correction, out)
            else:
                _visit_curved_row(cells, displacement, reference, deformed, e, row, inside, scratch, n_kinds,
                                  correction, out)
        if out.size > 0:
            continue
        for kind in range(n_kinds):
            for component in range(3):
                first = 8 * (3 * kind + component)
                for m in range(cells.n_monomials[e]):
                    sums.moments[e, kind, component, m] += (scratch.moments[first + m]
                                                            + _total_at(scratch.sums, first + m))
                # Of a tetrahedron rows give mixed terms too, which belong to nothing.
                store(scratch.moments, first, fill_wide(0.0))
        for k in range(N_SUMS):
            sums.grey[e, k] += _total_at(scratch.grey, k)


def _residual_sums(cells, displacement, reference, deformed, all_kinds, sums):
    """Accumulate, per cell, moments of the residual against grad f and the monomials, and plain sums.

    ``displacement`` holds the coefficients of u on the monomials, (n_cells, 3, n_monomials), voxels; ``deformed`` is a
    box of g that holds all x + u(x) that lie in the volume. With ``all_kinds`` the moments of g and of 1 are
    accumulated too, for which ``sums`` has room.
    """
    moments = sums.moments if all_kinds else sums.moments[:, :1]
    _visit(cells, displacement, reference, deformed, sums._replace(moments=moments), _NO_CORRECTION, _NO_VOLUME)


def _fill_residual_pixels(cells, displacement, reference, deformed, correction, out):
    """Write f - gain g(x + u) - offset of all cells' voxels.

    ``displacement`` and ``deformed`` are those of ``_residual_sums``. ``correction`` are gain, and offset in grey
    levels, of each cell, (2, n_cells). ``out`` has the reference box's shape, float32, grey levels; NaN where a cell's
    voxel does not count.
    """
    nothing = CellSums(np.zeros((0, 1, 3, 4)), np.zeros((0, N_SUMS)))
    _visit(cells, displacement, reference, deformed, nothing, correction, out)


_NO_CORRECTION = np.zeros((2, 0))
_NO_VOLUME = np.zeros((0, 0, 0), np.float32)


@numba.njit(**INLINED)
def _add_slopes(scratch, reference, row, k, n):
    """Add n neighbouring voxels, the first of which is k after the row's first, to sums of grad f grad f^T.

    By lanes, and of the same times the place in the row, and its square.
    """
    counts = _count_voxels(reference, row, row.x + k, n, scratch)
    f_x, f_y, f_z = _find_gradient(reference, _find_place(reference, row.x + k, row.y, row.z))
    f_x, f_y, f_z = widen(counts * f_x), widen(counts * f_y), widen(counts * f_z)
    place = widen(count() + fill(1.0 * k))
    _add_powers(scratch.sums, 0, f_x * f_x, place)
    _add_powers(scratch.sums, 3, f_x * f_y, place)
    _add_powers(scratch.sums, 6, f_x * f_z, place)
    _add_powers(scratch.sums, 9, f_y * f_y, place)
    _add_powers(scratch.sums, 12, f_y * f_z, place)
    _add_powers(scratch.sums, 15, f_z * f_z, place)


@numba.njit(**INLINED)
def _add_powers(sums, first, value, place):
    along = value * place
    _add_at(sums, first, value)
    _add_at(sums, first + 1, along)
    _add_at(sums, first + 2, along * place)


@numba.njit(**INLINED)
def _spread_slopes(scratch, n_monomials):
    """Add the sums of a row to those of grad f grad f^T times products of two monomials, which are linear in it."""
    phi, slope = scratch.phi, scratch.slope
    all_phi, all_slope = load(phi, 0), load(slope, 0)
    for pair in range(6):
        p_0, p_1 = _total_at(scratch.sums, 3 * pair), _total_at(scratch.sums, 3 * pair + 1)
        p_2 = _total_at(scratch.sums, 3 * pair + 2)
        for m in range(n_monomials):
            a, b = p_0 * phi[m] + p_1 * slope[m], p_1 * phi[m] + p_2 * slope[m]
            _add_at(scratch.products, 8 * pair + m, fill_wide(a) * all_phi + fill_wide(b) * all_slope)


@numba.njit(**INLINED)
def _add_curved_slopes(scratch, reference, row, k, n):
    """Add the same to sums of grad f grad f^T times products of two monomials, by lanes."""
    counts = _count_voxels(reference, row, row.x + k, n, scratch)
    lanes, sums = scratch.lanes, scratch.pairs
    f_x, f_y, f_z = _find_gradient(reference, _find_place(reference, row.x + k, row.y, row.z))
    f_x, f_y, f_z = counts * f_x, counts * f_y, counts * f_z
    xx, xy, xz = widen(f_x * f_x), widen(f_x * f_y), widen(f_x * f_z)
    yy, yz, zz = widen(f_y * f_y), widen(f_y * f_z), widen(f_z * f_z)
    first = 0
    for m in range(8):
        one = load(lanes, m * WIDTH)
        for other in range(m, 8):
            product = widen(one * load(lanes, other * WIDTH))
            _add_at(sums, first, xx * product)
            _add_at(sums, first + 1, xy * product)
            _add_at(sums, first + 2, xz * product)
            _add_at(sums, first + 3, yy * product)
            _add_at(sums, first + 4, yz * product)
            _add_at(sums, first + 5, zz * product)
            first += 6


@numba.njit(**INLINED)
def _total_pairs(scratch):
    """Add up the lanes of the sums of a cell that is not linear along rows."""
    first = 0
    for m in range(8):
        for k in range(m, 8):
            for pair in range(6):
                value = _total_at(scratch.pairs, first + pair)
                scratch.products[64 * pair + 8 * m + k] += value
                if k > m:
                    scratch.products[64 * pair + 8 * k + m] += value
            first += 6


@numba.njit(**INLINED)
def _combine_products(scratch, T, e, out):
    """Write M_e into out[e] (n, 3, n, 3) from sums of products of monomials, of which shape functions are T (n, n)."""
    half, size, pair = scratch.half, len(T), 0
    for c in range(3):
        for d in range(c, 3):
            for a in range(size):
                for n in range(size):
                    value = 0.0
                    for m in range(size):
                        value += T[a, m] * scratch.products[64 * pair + 8 * m + n]
                    half[a, n] = value
            for a in range(size):
                for b in range(size):
                    value = 0.0
                    for n in range(size):
                        value += half[a, n] * T[b, n]
                    out[e, a, c, b, d] = value
                    out[e, a, d, b, c] = value
            pair += 1
    for place in range(len(scratch.products)):
        scratch.products[place] = 0.0


@numba.njit(**FLAGS)
def _hessian_cells(cells, shapes, reference, out):
    """Assemble M_e = sum_vx N_a N_b grad f grad f^T of every cell, Eq. 7 of [BP17].

    ``out`` is (n_cells, n_monomials, 3, n_monomials, 3) by a, component, b, component; grey levels squared per voxel
    squared.
    """
    scratch = _new_scratch()
    for visit in range(len(cells.order)):
        e = cells.order[visit]
        is_linear = _is_linear(cells.geometry, cells.n_monomials[e], e, scratch.inverse)
        for run in range(cells.row_ptr[e], cells.row_ptr[e + 1]):
            row = _find_row(cells, e, run)
            if row.x >= row.stop:
                continue
            length = row.stop - row.x
            if is_linear:
                _begin_row(cells.geometry, e, row, scratch)
                for k in range(0, length, WIDTH):
                    _add_slopes(scratch, reference, row, k, min(length - k, WIDTH))
                _spread_slopes(scratch, cells.n_monomials[e])
            else:
                for k in range(0, length, WIDTH):
                    n = min(length - k, WIDTH)
                    _, _, _, is_found = _place_curved(cells.geometry, e, row, row.x + k, n, scratch)
                    _add_curved_slopes(scratch, reference, row, k, n if is_found else 0)
        if not is_linear:
            _total_pairs(scratch)
        _combine_products(scratch, shapes.coefficients[shapes.kinds[e]], e, out)


_NOTHING_EXCLUDED = np.zeros((0, 0, 0), dtype=np.uint8)


def _convert_reference(f: GradientImage) -> ReferenceVoxels:
    """Convert a box of the reference volume; its arrays are not copied."""
    layout = _describe_layout(f.values, f.window.grow(f.margin))
    return ReferenceVoxels(flatten(f.values), flatten(f.slopes[0]), *layout,
                           _NOTHING_EXCLUDED if f.usable is None else f.usable, np.array(f.window.lower))


def _convert_deformed(g: SplineImage, extent: Window) -> DeformedVoxels:
    """Convert a box of the deformed volume, ``extent`` being the whole one; its arrays are not copied."""
    layout = _describe_layout(g.coefficients, g.window.grow(PADDING[volume.DEGREE]))
    return DeformedVoxels(flatten(g.coefficients), *layout, g.scale, g.offset,
                          _NOTHING_EXCLUDED if g.usable is None else g.usable, np.array(g.window.lower),
                          np.array(extent.sizes))


def _describe_layout(values: NDArray[Any], box: Window) -> tuple[int, int, int]:
    """From one row to the next, from one plane, and where voxel (0, 0, 0) is, or would be."""
    row_length, plane_length = count_step(values, 1), count_step(values, 0)
    x, y, z = box.lower
    return row_length, plane_length, -(z * plane_length + y * row_length + x)


def _take_cells(order: IntArray, interpolation: CellInterpolation, raster: Raster) -> _Cells:
    """Take cells as kernels do, in the order of visiting."""
    # Shape functions without a mixed term are those of tetrahedra.
    is_mixed = interpolation.shapes[:, :, 4:].any(axis=(1, 2))
    n_monomials = np.where(is_mixed, 8, 4)[interpolation.kinds]
    return _Cells(order, interpolation.geometry, n_monomials, raster.first_rows, raster.n_rows, raster.row_ptr,
                 raster.starts, raster.stops)


COMPILED = PixelKernels(_hessian_cells, _residual_sums, _fill_residual_pixels, _convert_reference, _convert_deformed,
                        _take_cells)
"""Of tetrahedra and hexahedra."""
