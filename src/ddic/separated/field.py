"""A displacement as a sum of products of functions of x and of y, Eq. (14) of [PP12]; sums over bands of its rows.

The functions are those of one-dimensional linear elements along a side of a rectangle, which know the pixels that lie
in them. Matrices of one-dimensional problems are kept by their diagonals: entry [w + k, i] of (2 w + 1, n) couples i to
i + k.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Protocol, TypeVar

import numpy as np
from scipy import linalg

from ddic.arrays import Array, IntArray
from ddic.errors import SingularSubdomainError
from ddic.mesh.raster import SNAP

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class LineElements:
    """Linear elements between nodes on a line.

    A pixel centre belongs to the element that holds it, its lower end included, its upper end not: those of Q4 on the
    same lines have the same pixels.

    Attributes
    ----------
    nodes : (n_nodes,) array
        Ascending, pixels.
    """

    nodes: Array

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.nodes)

    @property
    def length(self) -> float:
        """From the first node to the last, pixels."""
        return float(self.nodes[-1] - self.nodes[0])

    @cached_property
    def pixels(self) -> range:
        """Pixel centres between the first node and the last."""
        ends = np.round(self.nodes[[0, -1]] * SNAP) / SNAP
        first, stop = np.ceil(ends).astype(int)
        return range(int(first), int(stop))

    @cached_property
    def _elements(self) -> IntArray:
        """Element of each pixel, (n_pixels,)."""
        snapped = np.round(self.nodes * SNAP) / SNAP
        found = np.searchsorted(snapped, np.arange(self.pixels.start, self.pixels.stop), side="right") - 1
        return np.clip(found, 0, self.n_nodes - 2).astype(np.int64)

    @cached_property
    def _shares(self) -> Array:
        """Value of the upper node's function at each pixel, (n_pixels,); the lower one's is what is left to 1."""
        places = np.arange(self.pixels.start, self.pixels.stop, dtype=float)
        return np.asarray((places - self.nodes[self._elements]) / np.diff(self.nodes)[self._elements])

    def count_pixels(self) -> IntArray:
        """Count the pixels of each element, (n_nodes - 1,)."""
        return np.bincount(self._elements, minlength=self.n_nodes - 1).astype(np.int64)

    def evaluate_at_pixels(self, values: Array) -> Array:
        """Evaluate functions with values (..., n_nodes) at pixel centres, (..., n_pixels)."""
        lower = values[..., self._elements]
        return np.asarray(lower + self._shares * (values[..., self._elements + 1] - lower))

    def evaluate(self, values: Array, points: Array) -> Array:
        """Evaluate functions (..., n_nodes) at points (n,), pixels; beyond the ends they keep the value of the end."""
        places = np.clip(points, self.nodes[0], self.nodes[-1])
        elements = np.clip(np.searchsorted(self.nodes, places, side="right") - 1, 0, self.n_nodes - 2)
        shares = (places - self.nodes[elements]) / np.diff(self.nodes)[elements]
        lower = values[..., elements]
        return np.asarray(lower + shares * (values[..., elements + 1] - lower))

    def sum_at_nodes(self, of_pixels: Array) -> Array:
        """Sum per-pixel numbers against the shape functions: N^T of_pixels, (n_nodes,)."""
        upper = of_pixels * self._shares
        return self._sum_by_node(of_pixels - upper, 0) + self._sum_by_node(upper, 1)

    def assemble(self, weights: Array) -> Array:
        """Assemble N^T diag(weights) N, weights (n_pixels,), as diagonals (3, n_nodes)."""
        upper, lower = self._shares, 1.0 - self._shares
        bands = np.zeros((3, self.n_nodes))
        bands[1] = self._sum_by_node(weights * lower**2, 0) + self._sum_by_node(weights * upper**2, 1)
        coupled = self._sum_by_node(weights * lower * upper, 0)
        bands[2] = coupled
        bands[0, 1:] = coupled[:-1]
        return bands

    def _sum_by_node(self, of_pixels: Array, end: int) -> Array:
        """Sums over pixels at the lower (0) or upper (1) node of their element, (n_nodes,)."""
        summed = np.bincount(self._elements + end, weights=of_pixels, minlength=self.n_nodes)
        return np.asarray(summed, dtype=np.float64)

    @cached_property
    def mass(self) -> Array:
        """Integrals of N_i N_j over the line, as diagonals (3, n_nodes), pixels."""
        h = np.diff(self.nodes)
        return self._assemble_elements(h / 3.0, h / 6.0, h / 6.0, h / 3.0)

    @cached_property
    def stiffness(self) -> Array:
        """Integrals of N_i' N_j', as diagonals (3, n_nodes), 1 / pixels."""
        inverse = 1.0 / np.diff(self.nodes)
        return self._assemble_elements(inverse, -inverse, -inverse, inverse)

    @cached_property
    def mixed(self) -> Array:
        """Integrals of N_i' N_j, as diagonals (3, n_nodes), no unit."""
        half = np.full(self.n_nodes - 1, 0.5)
        return self._assemble_elements(-half, -half, half, half)

    def _assemble_elements(self, lower: Array, above: Array, below: Array, upper: Array) -> Array:
        """Diagonals from the entries (lower, lower), (lower, upper), (upper, lower), (upper, upper) of elements."""
        bands = np.zeros((3, self.n_nodes))
        bands[1, :-1] += lower
        bands[1, 1:] += upper
        bands[2, :-1] = above
        bands[0, 1:] = below
        return bands


def multiply(bands: Array, vectors: Array) -> Array:
    """Multiply matrices (..., 2 w + 1, n) by vectors (..., n), whose leading axes broadcast with theirs."""
    width, n = bands.shape[-2] // 2, bands.shape[-1]
    product = bands[..., width, :] * vectors
    for k in range(1, min(width, n - 1) + 1):
        product[..., :-k] += bands[..., width + k, :-k] * vectors[..., k:]
        product[..., k:] += bands[..., width - k, k:] * vectors[..., :-k]
    return np.asarray(product)


def multiply_matrices(left: Array, right: Array) -> Array:
    """Multiply two matrices (2 w + 1, n) and (2 w' + 1, n); the product is (2 (w + w') + 1, n)."""
    of_left, of_right, n = len(left) // 2, len(right) // 2, left.shape[1]
    width = of_left + of_right
    product = np.zeros((2 * width + 1, n))
    for k in range(-of_left, of_left + 1):
        for m in range(-of_right, of_right + 1):
            rows = np.arange(max(0, -k, -k - m), min(n, n - k, n - k - m))
            product[width + k + m, rows] += left[of_left + k, rows] * right[of_right + m, rows + k]
    return product


def transpose(bands: Array) -> Array:
    """Transpose a matrix (2 w + 1, n)."""
    width, n = len(bands) // 2, bands.shape[1]
    turned = np.zeros_like(bands)
    for k in range(-width, width + 1):
        rows = np.arange(max(0, -k), min(n, n - k))
        turned[width - k, rows + k] = bands[width + k, rows]
    return turned


def pad_diagonals(bands: Array, width: int) -> Array:
    """Add empty diagonals to matrices (..., 2 w + 1, n) up to ``width``, which is at least w."""
    more = width - bands.shape[-2] // 2
    if not more:
        return bands
    return np.pad(bands, [(0, 0)] * (bands.ndim - 2) + [(more, more), (0, 0)])


def solve_coupled(blocks: Array, right: Array, what: str) -> Array:
    """Solve a symmetric positive definite system of several coupled functions along one direction, (m, n).

    Of functions c and d, ``blocks`` (m, m, 2 w + 1, n) holds the matrix that couples them. Raises
    SingularSubdomainError, in which ``what`` names the system, where the matrix is not positive definite.
    """
    m, width, n = len(blocks), blocks.shape[2] // 2, blocks.shape[3]
    # Function c of node i has the number m i + c; upper form of LAPACK.
    reach = m * width + m - 1
    upper = np.zeros((reach + 1, n, m))
    for k in range(width + 1):
        for c in range(m):
            for d in range(c if k == 0 else 0, m):
                upper[reach - (m * k + d - c), k:, d] = blocks[c, d, width + k, :n - k]
    try:
        solution = linalg.solveh_banded(upper.reshape(reach + 1, n * m), right.T.ravel(), overwrite_ab=True,
                                        check_finite=False)
    except linalg.LinAlgError as error:
        raise SingularSubdomainError(f"{what}: the images do not determine its functions; use larger elements, or "
                                     "[regularization]") from error
    return np.ascontiguousarray(solution.reshape(n, m).T)


def add_diagonals(one: Array, other: Array) -> Array:
    """Add matrices (..., 2 w + 1, n) of different widths; the sum is as wide as the wider one."""
    width = max(one.shape[-2], other.shape[-2]) // 2
    return pad_diagonals(one, width) + pad_diagonals(other, width)


_TINY = 1e-300
"""A norm below any that is not 0."""


@dataclass(frozen=True, eq=False)
class SeparatedField:
    """Sum of products u_c(x, y) = sum_k a_kc X_kc(x) Y_kc(y) for both components c.

    Attributes
    ----------
    along_x, along_y : LineElements
        Of the functions of x and of y.
    amplitudes : (n_modes, 2) array
        a, RMS displacement of each mode over the rectangle, pixels.
    x : (n_modes, 2, along_x.n_nodes) array
        X at the nodes, of mean square 1 over the line.
    y : (n_modes, 2, along_y.n_nodes) array
        Y, likewise.
    """

    along_x: LineElements
    along_y: LineElements
    amplitudes: Array
    x: Array
    y: Array

    @property
    def n_modes(self) -> int:
        """Number of modes."""
        return len(self.amplitudes)

    @property
    def scaled_x(self) -> Array:
        """Functions of x times their amplitudes, (n_modes, 2, n_x), pixels."""
        return np.asarray(self.x * self.amplitudes[..., None])

    def add(self, other: SeparatedField) -> SeparatedField:
        """Add the modes of another field on the same elements; they come last."""
        return SeparatedField(self.along_x, self.along_y, np.concatenate([self.amplitudes, other.amplitudes]),
                              np.concatenate([self.x, other.x]), np.concatenate([self.y, other.y]))

    def evaluate_on_grid(self, x: Array, y: Array) -> Array:
        """Evaluate the displacement on a grid, (n_rows, n_columns, 2), pixels."""
        of_x = self.along_x.evaluate(self.scaled_x, x)
        of_y = self.along_y.evaluate(self.y, y)
        return np.stack([of_y[:, c].T @ of_x[:, c] for c in range(2)], axis=-1)

    def at(self, points: Array) -> Array:
        """Evaluate the displacement at points (n, 2), pixels; nan outside the rectangle."""
        u = np.zeros(points.shape)
        for amplitude, x, y in zip(self.amplitudes, self.x, self.y, strict=True):
            products = self.along_x.evaluate(x, points[:, 0]) * self.along_y.evaluate(y, points[:, 1])
            u += (amplitude[:, None] * products).T
        low = (self.along_x.nodes[0], self.along_y.nodes[0])
        high = (self.along_x.nodes[-1], self.along_y.nodes[-1])
        inside = ((points >= low) & (points <= high)).all(axis=1)
        return np.where(inside[:, None], u, np.nan)

    def measure_rms(self, *, without_mean: bool = False) -> Array:
        """Measure the root mean square over the rectangle from the functions alone, (2,), pixels."""
        of_x, of_y = _multiply_all(self.along_x, self.x), _multiply_all(self.along_y, self.y)
        squares = np.einsum("kc,lc,ckl,ckl->c", self.amplitudes, self.amplitudes, of_x, of_y)
        if without_mean:
            means = self.amplitudes * _average(self.along_x, self.x) * _average(self.along_y, self.y)
            squares = squares - means.sum(axis=0) ** 2
        return np.asarray(np.sqrt(np.maximum(squares, 0.0)))

    def measure_difference(self, other: SeparatedField) -> Array:
        """Measure the RMS difference to another field on the same elements, however small beside both, (2,), pixels."""
        negative = SeparatedField(other.along_x, other.along_y, -other.amplitudes, other.x, other.y)
        # Sums of squares of the products would cancel: half of the digits would be lost.
        return np.asarray(np.sqrt((self.add(negative).reduce_modes(0.0).amplitudes**2).sum(axis=0)))

    def reduce_modes(self, tolerance: float) -> SeparatedField:
        """Write the same field with orthogonal functions, as few as ``tolerance`` allows, largest first.

        That is the RMS displacement that may be lost in each component, pixels. A QR factorisation of the functions of
        each direction, and a singular value decomposition of what couples them.
        """
        if not self.n_modes:
            return self
        components = (_recompress_component(self, c, tolerance) for c in range(2))
        amplitudes, x, y = (join_components(parts) for parts in zip(*components, strict=True))
        return SeparatedField(self.along_x, self.along_y, amplitudes, x, y)


def scale_modes(along_x: LineElements, along_y: LineElements, x: Array, y: Array) -> SeparatedField:
    """Make a field of modes ``x`` and ``y``, (n_modes, 2, n), whose products are displacements, pixels."""
    sizes = _measure_functions(along_x, x), _measure_functions(along_y, y)
    safe = [np.where(size > _TINY, size, 1.0)[..., None] for size in sizes]
    return SeparatedField(along_x, along_y, sizes[0] * sizes[1], x / safe[0], y / safe[1])


def factorize_grid(along_x: LineElements, along_y: LineElements, values: Array, tolerance: float) -> SeparatedField:
    """Separate a displacement that is given on the grid of all nodes or on a coarser one.

    A singular value decomposition of each component of ``values`` (n_rows, n_columns, 2), pixels; ``tolerance`` is the
    RMS displacement of the nodes that may be lost in each, pixels.
    """
    found = []
    for c in range(2):
        left, singular, right = np.linalg.svd(values[..., c], full_matrices=False)
        kept = _count_kept(singular / np.sqrt(values[..., c].size), tolerance)
        found.append((left[:, :kept].T, singular[:kept, None] * right[:kept]))
    y, x = (join_components(functions) for functions in zip(*found, strict=True))
    return scale_modes(along_x, along_y, x, y)


def join_components(of_components: Sequence[Array]) -> Array:
    """Join what both components' modes have, (n_modes of it, ...) each, with zeros where one has fewer modes."""
    n_modes = max(len(values) for values in of_components)
    return np.stack([np.pad(values, [(0, n_modes - len(values))] + [(0, 0)] * (values.ndim - 1))
                     for values in of_components], axis=1)


def _recompress_component(field: SeparatedField, c: int, tolerance: float) -> tuple[Array, Array, Array]:
    """Amplitudes (m,) and functions (m, n_x), (m, n_y) of one component."""
    q_x, r_x = orthonormalize(field.along_x, field.scaled_x[:, c])
    q_y, r_y = orthonormalize(field.along_y, field.y[:, c])
    left, singular, right = np.linalg.svd(r_x @ r_y.T)
    kept = _count_kept(singular, tolerance)
    return singular[:kept], left[:, :kept].T @ q_x, right[:kept] @ q_y


def orthonormalize(line: LineElements, functions: Array) -> tuple[Array, Array]:
    """Find orthogonal functions of mean square 1 that make up others (m, n_nodes), one after the other.

    Returns Q (k, n_nodes), k the smaller one of m and n_nodes, and R (k, m), upper triangular: functions = R^T Q.
    """
    # With the Cholesky factor L of the mass matrix, L^T f has the function's norm for its length. L^T is kept as
    # LAPACK has it: first row above the diagonal, second row the diagonal.
    factor = linalg.cholesky_banded(line.mass[:2] / line.length)
    scaled = factor[1][:, None] * functions.T
    scaled[:-1] += factor[0, 1:, None] * functions.T[1:]
    q, r = np.linalg.qr(scaled)
    return linalg.solve_banded((0, 1), factor, q).T.reshape(-1, line.n_nodes), r


def _count_kept(singular: Array, tolerance: float) -> int:
    """How many values to keep so that those left out have at most this root sum of squares; one at least."""
    left_out = np.sqrt(np.cumsum(singular[::-1] ** 2))[::-1]
    return max(int((left_out > tolerance).sum()), 1)


def _multiply_all(line: LineElements, functions: Array) -> Array:
    """Mean products of all pairs of functions, (2, n_modes, n_modes)."""
    weighted = multiply(line.mass, functions) / line.length
    return np.asarray(np.einsum("kci,lci->ckl", functions, weighted, optimize=True))


def _measure_functions(line: LineElements, functions: Array) -> Array:
    """Root mean squares, (n_modes, 2)."""
    squares = np.einsum("kci,kci->kc", functions, multiply(line.mass, functions)) / line.length
    return np.asarray(np.sqrt(np.maximum(squares, 0.0)))


def _average(line: LineElements, functions: Array) -> Array:
    """Means, (n_modes, 2)."""
    return np.asarray(multiply(line.mass, functions).sum(axis=-1) / line.length)


N_BANDS = 16
"""Bands of rows, whatever the number of ranks: most ranks that have work. More of them make more and smaller sweeps."""


def divide_rows(along_y: LineElements) -> list[range]:
    """Divide the rows of a rectangle into N_BANDS bands, or one a row where there are fewer."""
    rows = along_y.pixels
    edges = np.linspace(rows.start, rows.stop, min(N_BANDS, len(rows)) + 1).round().astype(int)
    return [range(int(a), int(b)) for a, b in pairwise(edges)]


class BandSums(Protocol):
    """Brings together what bands of rows give; every rank has the result."""

    def add_up(self, of_bands: Iterable[Array]) -> Array:
        """Sum arrays of one shape, one of each owned band in order, over the bands of all ranks."""

    def join(self, of_bands: Iterable[Array]) -> Array:
        """Put arrays, one of each owned band in order, side by side along their last axis, those of all ranks."""

    def broadcast(self, item: T) -> T:
        """Give all ranks what the first one has, so that rounding lets none of them decide otherwise."""

    def together(self, work: Callable[[], T]) -> T:
        """Run work, free of communication, that may fail on one rank alone, and return its result."""
