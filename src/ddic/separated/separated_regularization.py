"""Regularisation of a rectangle as a sum of products of one-dimensional matrices: Tikhonov and the equilibrium gap."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from ddic.arrays import Array, BoolArray, IntArray
from ddic.functionals.regularization import PHASES, Material
from ddic.separated.field import LineElements, multiply, multiply_matrices, pad_diagonals, transpose

Product = tuple[Array, Array]
"""A matrix along x and one along y, by their diagonals: their Kronecker product acts on the grid's nodes."""


@dataclass(frozen=True, eq=False)
class Wave:
    """A plane wave of one component along one axis, as a product of functions at the nodes.

    Attributes
    ----------
    component : int
        That moves.
    x, y : (n_x,) and (n_y,) array
        Of x, pixels, and of y, no unit.
    """

    component: int
    x: Array
    y: Array


@dataclass(frozen=True, eq=False)
class SeparatedOperator:
    """A symmetric operator L between the two components, L_cd = sum_t Ax_t (x) Ay_t.

    Attributes
    ----------
    rows, columns : (n_terms,) int64 array
        Components c and d that each term couples.
    x, y : (n_terms, 2 w + 1, n_x or n_y) array
        Matrices along x and along y.
    """

    rows: IntArray
    columns: IntArray
    x: Array
    y: Array

    def transpose(self) -> SeparatedOperator:
        """Exchange the directions: the same operator, x named y."""
        return SeparatedOperator(self.rows, self.columns, self.y, self.x)

    def reduce(self, left: Array, right: Array) -> Array:
        """Weigh the matrices along x by products of functions of y (2, n_y): Y_c^T Ay_t Y_d by term, (n_terms,)."""
        products = multiply(self.y, right[self.columns])
        return np.asarray(np.einsum("ti,ti->t", left[self.rows], products))

    def assemble(self, weights: Array) -> Array:
        """Sum the matrices along x, each with its weight, by the components that they couple, (2, 2, 2 w + 1, n_x)."""
        blocks = np.zeros((2, 2, *self.x.shape[1:]))
        for c, d in product(range(2), repeat=2):
            chosen = (self.rows == c) & (self.columns == d)
            blocks[c, d] = np.einsum("t,tki->ki", weights[chosen], self.x[chosen])
        return blocks

    def apply(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Multiply by modes (n_modes, 2, n), one direction alone: Ax_t X_d and Ay_t Y_d, (n_terms, n_modes, n)."""
        return (multiply(self.x[:, None], x[:, self.columns].swapaxes(0, 1)),
                multiply(self.y[:, None], y[:, self.columns].swapaxes(0, 1)))

    def measure_energy(self, x: Array, y: Array) -> float:
        """Measure u^T L u of the sum of modes (n_modes, 2, n)."""
        of_x, of_y = self.apply(x, y)
        rows = self.rows
        left = np.einsum("kti,tli->tkl", x[:, rows], of_x, optimize=True)
        right = np.einsum("kti,tli->tkl", y[:, rows], of_y, optimize=True)
        return float((left * right).sum())


def build_no_operator(along_x: LineElements, along_y: LineElements) -> SeparatedOperator:
    """Build the operator without terms, that of no regularisation."""
    none = np.zeros(0, np.int64)
    return SeparatedOperator(none, none, np.zeros((0, 1, along_x.n_nodes)), np.zeros((0, 1, along_y.n_nodes)))


def build_tikhonov(along_x: LineElements, along_y: LineElements) -> SeparatedOperator:
    """Build int grad u : grad v, uncoupled, no unit, whose Euler equation is Laplace's: Eq. (26)-(28) of [PP12]."""
    products = ((along_x.stiffness, along_y.mass), (along_x.mass, along_y.stiffness))
    return _stack([(c, c, matrices) for c in range(2) for matrices in products])


def factorize_stiffness(along_x: LineElements, along_y: LineElements,
                       material: Material) -> dict[tuple[int, int], list[Product]]:
    """Separate K of the Q4 elements between the lines of a rectangle, the material being the same everywhere.

    By components c and d, the products whose sum is K_cd. The material's axes are those of the image, in either order.
    """
    c = material.stiffness
    c_xx, c_yy, c_xy, mu = c[0, 0, 0, 0], c[1, 1, 1, 1], c[0, 0, 1, 1], c[0, 1, 0, 1]
    s_x, m_x, c_x = along_x.stiffness, along_x.mass, along_x.mixed
    s_y, m_y, c_y = along_y.stiffness, along_y.mass, along_y.mixed
    # v^T K u is the integral of C_cd dv_c/dx_c du_d/dx_d over all c and d, and of the shear stress
    # mu (du_x/dy + du_y/dx) times the shear dv_x/dy + dv_y/dx.
    return {
        (0, 0): [(c_xx * s_x, m_y), (mu * m_x, s_y)],
        (1, 1): [(c_yy * m_x, s_y), (mu * s_x, m_y)],
        (0, 1): [(c_xy * c_x, transpose(c_y)), (mu * transpose(c_x), c_y)],
        (1, 0): [(c_xy * transpose(c_x), c_y), (mu * c_x, transpose(c_y))],
    }


@dataclass(frozen=True, eq=False)
class ControlledLines:
    """Which nodes' equilibrium is imposed: those on controlled lines of both directions.

    Attributes
    ----------
    x, y : (n_x,) and (n_y,) array of bool
        Of the vertical and of the horizontal lines.
    """

    x: BoolArray
    y: BoolArray

    def factorize_weights(self, of_others: float) -> list[tuple[Array, Array]]:
        """Factorize the squares of the weights of rows: products (n_x,), (n_y,) whose sum is that of each node.

        Controlled rows weigh 1, all others ``of_others``.
        """
        controlled = (self.x.astype(float), self.y.astype(float))
        if of_others == 0 or (self.x.all() and self.y.all()):
            return [controlled]
        everywhere = (np.full(len(self.x), of_others**2), np.ones(len(self.y)))
        return [((1.0 - of_others**2) * controlled[0], controlled[1]), everywhere]


def build_equilibrium_gap(along_x: LineElements, along_y: LineElements, material: Material,
                          controlled: ControlledLines, edge_weight: float = 0.0) -> SeparatedOperator:
    """Build Kbar^T Kbar, Kbar = P K, of the Q4 elements between the lines of a rectangle, square pixels.

    P is 1 on controlled lines and ``edge_weight`` elsewhere; the material is the same everywhere. Eight terms for each
    pair of components, sixteen with a weight of edges.
    """
    stiffness = factorize_stiffness(along_x, along_y, material)
    terms: list[tuple[int, int, Product]] = []
    for p_x, p_y in controlled.factorize_weights(edge_weight):
        for c, d, row in product(range(2), repeat=3):
            for (left_x, left_y), (right_x, right_y) in product(stiffness[row, c], stiffness[row, d]):
                terms.append((c, d, (multiply_matrices(transpose(left_x), p_x * right_x),
                                     multiply_matrices(transpose(left_y), p_y * right_y))))
    return _stack(terms)


def _stack(terms: Sequence[tuple[int, int, Product]]) -> SeparatedOperator:
    rows, columns, products = zip(*terms, strict=True)
    width = max(len(matrix) // 2 for product in products for matrix in product)
    of_x = np.stack([pad_diagonals(x, width) for x, _ in products])
    of_y = np.stack([pad_diagonals(y, width) for _, y in products])
    return SeparatedOperator(np.array(rows), np.array(columns), of_x, of_y)


def build_plane_waves(along_x: LineElements, along_y: LineElements, wavelength: float) -> list[Wave]:
    """Build the waves v = e_a cos(2 pi x_b / l_c + phi) of ``evaluate_plane_waves``, in its order.

    That is all axes a, b and phases phi, the phase varying fastest, then b; ``wavelength`` is l_c, pixels.
    """
    waves, lines = [], (along_x, along_y)
    for a, b, phase in product(range(2), range(2), PHASES):
        functions = [np.ones(line.n_nodes) for line in lines]
        functions[b] = np.cos(2 * np.pi * lines[b].nodes / wavelength + phase)
        waves.append(Wave(a, functions[0], functions[1]))
    return waves


def measure_wave_gaps(along_x: LineElements, along_y: LineElements, material: Material, waves: Sequence[Wave]) -> Array:
    """Measure |K v|^2 of waves on the inner nodes' rows, (n_waves,), square pixels, as ``measure_gap_energies``."""
    stiffness = factorize_stiffness(along_x, along_y, material)
    energies = np.zeros(len(waves))
    for number, wave in enumerate(waves):
        for row in range(2):
            forces = [(multiply(matrix_x, wave.x)[1:-1], multiply(matrix_y, wave.y)[1:-1])
                      for matrix_x, matrix_y in stiffness[row, wave.component]]
            energies[number] += sum(float(x @ other_x) * float(y @ other_y)
                                    for x, y in forces for other_x, other_y in forces)
    return energies


def measure_wave_gradients(operator: SeparatedOperator, waves: Sequence[Wave]) -> Array:
    """Measure v^T L v of waves, (n_waves,), in the unit of L times square pixels."""
    energies = []
    for wave in waves:
        axis = np.eye(2)[None, wave.component, :, None]
        energies.append(operator.measure_energy(axis * wave.x, axis * wave.y))
    return np.array(energies)


SumTexture = Callable[[int, Array, Array], float]
"""Gives the sum over pixels of f_a^2 p(x) q(y), of a component a and values of p and q at columns and rows."""


def measure_wave_textures(along_x: LineElements, along_y: LineElements, waves: Sequence[Wave],
                          sum_texture: SumTexture) -> Array:
    """Measure v^T M v of waves on the inner nodes' rows, (n_waves,), grey levels squared.

    As ``measure_texture_energies`` does, with sums over the pixels of the reference image.
    """
    energies = []
    for wave in waves:
        x = along_x.evaluate_at_pixels(wave.x) * along_x.evaluate_at_pixels(_inner(wave.x))
        y = along_y.evaluate_at_pixels(wave.y) * along_y.evaluate_at_pixels(_inner(wave.y))
        energies.append(sum_texture(wave.component, x, y))
    return np.array(energies)


def _inner(values: Array) -> Array:
    """Values of the inner nodes, 0 at both ends."""
    inner = values.copy()
    inner[[0, -1]] = 0.0
    return inner
