"""A displacement as a sum of products of functions of x and of y, Eq. (12) of [PP12]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.separated.diagonals import multiply
from ddic.separated.line_elements import LineElements

Array = NDArray[np.float64]

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
        """Add the modes of another field on the same elements.

        Parameters
        ----------
        other : SeparatedField
            Its modes come last.

        Returns
        -------
        SeparatedField
            The sum.
        """
        return SeparatedField(self.along_x, self.along_y, np.concatenate([self.amplitudes, other.amplitudes]),
                              np.concatenate([self.x, other.x]), np.concatenate([self.y, other.y]))

    def evaluate_on_grid(self, x: Array, y: Array) -> Array:
        """Evaluate on a grid.

        Parameters
        ----------
        x : (n_columns,) array
            Pixels.
        y : (n_rows,) array
            Pixels.

        Returns
        -------
        (n_rows, n_columns, 2) array
            Displacement, pixels.
        """
        of_x = self.along_x.evaluate(self.scaled_x, x)
        of_y = self.along_y.evaluate(self.y, y)
        return np.stack([of_y[:, c].T @ of_x[:, c] for c in range(2)], axis=-1)

    def at(self, points: Array) -> Array:
        """Evaluate at points.

        Parameters
        ----------
        points : (n, 2) array
            Pixels.

        Returns
        -------
        (n, 2) array
            Displacement, pixels; nan outside the rectangle.
        """
        u = np.zeros(points.shape)
        for amplitude, x, y in zip(self.amplitudes, self.x, self.y, strict=True):
            products = self.along_x.evaluate(x, points[:, 0]) * self.along_y.evaluate(y, points[:, 1])
            u += (amplitude[:, None] * products).T
        low = (self.along_x.nodes[0], self.along_y.nodes[0])
        high = (self.along_x.nodes[-1], self.along_y.nodes[-1])
        inside = ((points >= low) & (points <= high)).all(axis=1)
        return np.where(inside[:, None], u, np.nan)

    def measure_rms(self, *, without_mean: bool = False) -> Array:
        """Measure the root mean square over the rectangle from the functions alone.

        Parameters
        ----------
        without_mean : bool
            Whether each component's mean is taken off first.

        Returns
        -------
        (2,) array
            Of both components, pixels.
        """
        of_x, of_y = (_multiply_all(line, functions) for line, functions in ((self.along_x, self.x),
                                                                             (self.along_y, self.y)))
        squares = np.einsum("kc,lc,ckl,ckl->c", self.amplitudes, self.amplitudes, of_x, of_y)
        if without_mean:
            means = self.amplitudes * _average(self.along_x, self.x) * _average(self.along_y, self.y)
            squares = squares - means.sum(axis=0) ** 2
        return np.asarray(np.sqrt(np.maximum(squares, 0.0)))

    def measure_difference(self, other: SeparatedField) -> Array:
        """Measure the root mean square difference to another field, however small beside both.

        Parameters
        ----------
        other : SeparatedField
            On the same elements.

        Returns
        -------
        (2,) array
            Of both components, pixels.
        """
        negative = SeparatedField(other.along_x, other.along_y, -other.amplitudes, other.x, other.y)
        # Sums of squares of the products would cancel: half of the digits would be lost.
        return np.asarray(np.sqrt((self.add(negative).reduce_modes(0.0).amplitudes**2).sum(axis=0)))

    def reduce_modes(self, tolerance: float) -> SeparatedField:
        """Write the same field with orthogonal functions, largest first.

        Parameters
        ----------
        tolerance : float
            RMS displacement that may be lost in each component, pixels.

        Returns
        -------
        SeparatedField
            With as few modes as that allows: a QR factorisation of the functions of each direction, and a singular
            value decomposition of what couples them.
        """
        if not self.n_modes:
            return self
        components = [_recompress_component(self, c, tolerance) for c in range(2)]
        n_modes = max(len(amplitudes) for amplitudes, _, _ in components)
        padded = [(np.pad(a, (0, n_modes - len(a))), _pad(x, n_modes), _pad(y, n_modes)) for a, x, y in components]
        amplitudes, x, y = (np.stack(parts, axis=1) for parts in zip(*padded, strict=True))
        return SeparatedField(self.along_x, self.along_y, amplitudes, x, y)


def build_zero_field(along_x: LineElements, along_y: LineElements) -> SeparatedField:
    """Build a field without modes.

    Parameters
    ----------
    along_x, along_y : LineElements
        Of its functions.

    Returns
    -------
    SeparatedField
        Zero everywhere.
    """
    return SeparatedField(along_x, along_y, np.zeros((0, 2)), np.zeros((0, 2, along_x.n_nodes)),
                          np.zeros((0, 2, along_y.n_nodes)))


def scale_modes(along_x: LineElements, along_y: LineElements, x: Array, y: Array) -> SeparatedField:
    """Give modes functions of mean square 1, and amplitudes.

    Parameters
    ----------
    along_x, along_y : LineElements
        Of the functions.
    x : (n_modes, 2, n_x) array
        Functions of x.
    y : (n_modes, 2, n_y) array
        Functions of y; their products with those of x are displacements, pixels.

    Returns
    -------
    SeparatedField
        The same displacement.
    """
    sizes = _measure_functions(along_x, x), _measure_functions(along_y, y)
    safe = [np.where(size > _TINY, size, 1.0)[..., None] for size in sizes]
    return SeparatedField(along_x, along_y, sizes[0] * sizes[1], x / safe[0], y / safe[1])


def factorize_grid(along_x: LineElements, along_y: LineElements, values: Array, tolerance: float) -> SeparatedField:
    """Separate a displacement that is given on the grid of all nodes or on a coarser one.

    Parameters
    ----------
    along_x, along_y : LineElements
        Of the grid's lines.
    values : (n_rows, n_columns, 2) array
        Displacement of its nodes, pixels.
    tolerance : float
        RMS displacement of the nodes that may be lost in each component, pixels.

    Returns
    -------
    SeparatedField
        A singular value decomposition of each component.
    """
    found = []
    for c in range(2):
        left, singular, right = np.linalg.svd(values[..., c], full_matrices=False)
        kept = _count_kept(singular / np.sqrt(values[..., c].size), tolerance)
        found.append((left[:, :kept].T, singular[:kept, None] * right[:kept]))
    n_modes = max(len(rows) for rows, _ in found)
    x = np.stack([_pad(columns, n_modes) for _, columns in found], axis=1)
    y = np.stack([_pad(rows, n_modes) for rows, _ in found], axis=1)
    return scale_modes(along_x, along_y, x, y)


def _recompress_component(field: SeparatedField, c: int, tolerance: float) -> tuple[Array, Array, Array]:
    """Amplitudes (m,) and functions (m, n_x), (m, n_y) of one component."""
    q_x, r_x = orthonormalize(field.along_x, field.scaled_x[:, c])
    q_y, r_y = orthonormalize(field.along_y, field.y[:, c])
    left, singular, right = np.linalg.svd(r_x @ r_y.T)
    kept = _count_kept(singular, tolerance)
    return singular[:kept], left[:, :kept].T @ q_x, right[:kept] @ q_y


def orthonormalize(line: LineElements, functions: Array) -> tuple[Array, Array]:
    """Find orthogonal functions of mean square 1 that make up others, one after the other.

    Parameters
    ----------
    line : LineElements
        On which they live.
    functions : (m, n_nodes) array
        At the nodes.

    Returns
    -------
    orthonormal : (k, n_nodes) array
        Q, k the smaller one of m and n_nodes.
    coefficients : (k, m) array
        R, upper triangular: functions = R^T Q.
    """
    # With the Cholesky factor L of the mass matrix, L^T f has the function's norm for its length.
    n = line.n_nodes
    diagonal, beside = line.mass[1] / line.length, line.mass[2] / line.length
    factor = _factorize_tridiagonal(diagonal, beside)
    scaled = _multiply_upper(factor, functions.T)
    q, r = np.linalg.qr(scaled)
    return _solve_upper(factor, q).T.reshape(-1, n), r


def _factorize_tridiagonal(diagonal: Array, beside: Array) -> Array:
    """Upper Cholesky factor, (2, n): first row above the diagonal, second row the diagonal."""
    from scipy.linalg import cholesky_banded

    upper = np.stack([np.concatenate([[0.0], beside[:-1]]), diagonal])
    return np.asarray(cholesky_banded(upper))


def _multiply_upper(factor: Array, columns: Array) -> Array:
    product = factor[1][:, None] * columns
    product[:-1] += factor[0, 1:, None] * columns[1:]
    return np.asarray(product)


def _solve_upper(factor: Array, columns: Array) -> Array:
    from scipy.linalg import solve_banded

    return np.asarray(solve_banded((0, 1), factor, columns))


def _count_kept(singular: Array, tolerance: float) -> int:
    """How many values to keep so that those left out have at most this root sum of squares; one at least."""
    left_out = np.sqrt(np.cumsum(singular[::-1] ** 2))[::-1]
    return max(int((left_out > tolerance).sum()), 1)


def _pad(functions: Array, n_modes: int) -> Array:
    return np.pad(functions, ((0, n_modes - len(functions)), (0, 0)))


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
