"""The best rank-one correction, Fig. 2 and Eq. (19)-(24) of [PP12]; all functions of one direction found anew."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np

from ddic.arrays import Array, IntArray
from ddic.separated.field import (
    LineElements,
    SeparatedField,
    add_diagonals,
    join_components,
    multiply,
    orthonormalize,
    scale_modes,
    solve_coupled,
)
from ddic.separated.pixel_bands import FramePixels
from ddic.separated.separated_regularization import SeparatedOperator

HELD = 1e-9
"""Stiffness, relative to the mean diagonal of what pixels give, by which nodes without a pixel follow their
neighbours. Larger values draw textured nodes along: this one changes them by less than 1e-8 of the displacement."""

ANCHORED = 1e-8
"""Share of that stiffness that draws functions of a component which no pixel shows to zero."""

LARGEST_BLOCKS = 16
"""Blocks along a side in which the residual is looked at for the first functions of y."""

_TINY = 1e-300
"""A size below any that is not 0."""


@dataclass(frozen=True, eq=False)
class Direction:
    """One half of the fixed point: functions of one direction sought, those of the other given.

    Attributes
    ----------
    line, other : LineElements
        Of the functions sought, and of those given.
    integrate : callable
        From values of the given functions at pixels (2, n_other) to the five integrals in Eq. (19) of [PP12],
        (5, n_pixels).
    operator : SeparatedOperator
        Regularisation, weight included, its x along ``line``.
    of_line, of_other : (n_terms, n_modes, n) array
        What its matrices make of the field so far, along both directions.
    name : str
        Of the direction, for messages.
    """

    line: LineElements
    other: LineElements
    integrate: Callable[[Array], Array]
    operator: SeparatedOperator
    of_line: Array
    of_other: Array
    name: str

    def solve(self, given: Array) -> tuple[Array, float]:
        """Find both components' functions (2, n), coupled, for given ones (2, n_other): Eq. (19)-(21) of [PP12].

        Also returns by how much the correction lowers half the sum of squared residuals with its regularisation, grey
        levels squared.
        """
        sums = self.integrate(self.other.evaluate_at_pixels(given))
        blocks = _assemble_blocks(self.line, sums[[0, 1, 1, 2]].reshape(2, 2, -1))
        right = np.stack([self.line.sum_at_nodes(row) for row in sums[3:]]) - self._regularize(given)
        blocks = add_diagonals(blocks, self.operator.assemble(self.operator.reduce(given, given)))
        functions = solve_coupled(blocks, right, f"correction along {self.name}")
        return functions, 0.5 * float((right * functions).sum())

    def _regularize(self, given: Array) -> Array:
        """L u against the given functions, (2, n)."""
        rows = self.operator.rows
        products = np.einsum("ti,tki->tk", given[rows], self.of_other)
        of_terms = np.einsum("tk,tki->ti", products, self.of_line)
        return np.stack([of_terms[rows == c].sum(axis=0) for c in range(2)])


def _assemble_blocks(line: LineElements, data: Array) -> Array:
    """Assemble the matrices between all functions from their integrals at pixels (m, m, n_pixels), (m, m, 3, n).

    With what holds the nodes that no pixel shows, diagonal in the functions.
    """
    m = len(data)
    blocks = np.empty((m, m, 3, line.n_nodes))
    for row in range(m):
        for column in range(row, m):
            blocks[row, column] = blocks[column, row] = line.assemble(data[row, column])
    every = np.arange(m)
    scale = HELD * float(blocks[every, every, 1].mean()) / float(line.stiffness[1].mean())
    held = scale * line.stiffness
    held[1] += ANCHORED * held[1].mean()
    blocks[every, every] += held
    return blocks


@dataclass(frozen=True)
class Mode:
    """A rank-one correction.

    Attributes
    ----------
    field : SeparatedField
        Of one mode.
    gain : float
        By how much it lowers half the sum of squared residuals with its regularisation, grey levels squared.
    n_sweeps : int
        Of the fixed point.
    stagnation : float
        Change from the last sweep but one to the last, relative to the mode, Eq. (25) of [PP12]; nan after one sweep.
    """

    field: SeparatedField
    gain: float
    n_sweeps: int
    stagnation: float


def build_directions(pixels: FramePixels, operator: SeparatedOperator,
                     displacement: SeparatedField) -> tuple[Direction, Direction]:
    """Set up both halves of the fixed point, for functions of x and of y, at a displacement.

    ``pixels`` hold the residual there; ``operator`` is the regularisation, weight included.
    """
    x, y = pixels.reference.along_x, pixels.reference.along_y
    of_x, of_y = operator.apply(displacement.scaled_x, displacement.y)
    return (Direction(x, y, pixels.integrate_over_y, operator, of_x, of_y, "x"),
            Direction(y, x, pixels.integrate_over_x, operator.transpose(), of_y, of_x, "y"))


def find_rank_one(pixels: FramePixels, directions: tuple[Direction, Direction], max_sweeps: int,
                  stagnation: float) -> Mode:
    """Find the rank-one correction that fits the residual best.

    It is taken after ``max_sweeps`` (k_max) of both directions each, or where its change from sweep to sweep, relative
    to it, is ``stagnation`` (e) or less.
    """
    along_x, along_y = directions
    broadcast = pixels.reference.sums.broadcast
    y = _estimate_functions(pixels)
    before: SeparatedField | None = None
    for n_sweeps in range(1, max_sweeps + 1):
        x, _ = broadcast(along_x.solve(y))
        y, gain = broadcast(along_y.solve(_scale(x)))
        found = scale_modes(along_x.line, along_y.line, _scale(x)[None], y[None])
        change = float("nan") if before is None else broadcast(_change(before, found))
        mode = Mode(found, gain, n_sweeps, change)
        if change <= stagnation:
            break
        before, y = found, _scale(y)
    return mode


def _estimate_functions(pixels: FramePixels) -> Array:
    """Guess functions of y, (2, n_y): what changes most from block to block of the residual, by singular values."""
    along_x, along_y = pixels.reference.along_x, pixels.reference.along_y
    edges_x, edges_y = (_block_edges(line) for line in (along_x, along_y))
    sums = pixels.sum_blocks(edges_x, edges_y)
    centres = along_y.pixels.start + (edges_y[1:] + edges_y[:-1] - 1) / 2
    guessed = []
    for of_component in sums:
        if not of_component.any():
            guessed.append(np.ones(along_y.n_nodes))
            continue
        left = np.linalg.svd(of_component)[0][:, 0]
        # Its sign is arbitrary; that of the largest entry is not.
        left *= np.sign(left[np.argmax(np.abs(left))])
        guessed.append(np.interp(along_y.nodes, centres, left))
    return pixels.reference.sums.broadcast(_scale(np.stack(guessed)))


def _block_edges(line: LineElements) -> IntArray:
    n = len(line.pixels)
    return np.linspace(0, n, min(LARGEST_BLOCKS, n) + 1).round().astype(np.int64)


def _scale(functions: Array) -> Array:
    """Functions of mean square 1 at the nodes, zero where they are."""
    size = np.sqrt((functions**2).mean(axis=1, keepdims=True))
    return np.asarray(functions / np.where(size > _TINY, size, 1.0))


def _change(before: SeparatedField, now: SeparatedField) -> float:
    """RMS of the difference of two modes relative to the second one."""
    difference = now.measure_difference(before)
    size = float(np.linalg.norm(now.measure_rms()))
    return float(np.linalg.norm(difference)) / max(size, _TINY)


NEGLECTED = 0.1
"""RMS of the modes whose functions are left as they are, relative to the new mode's. A smaller value takes the square
of the number of functions in time and memory, and no fewer corrections: 1e-3 takes as many as 0.1."""


MOST_RENEWED = 24
"""Functions of each component that are found anew at once, the new one and those of the largest modes: memory and time
grow with their square, to 0.4 GB for an image 10,000 px wide."""

DEPENDENT = 1e-6
"""Part of a function, of mean square 1, that is not made of those before it, below which it is left out."""


def renew_functions(pixels: FramePixels, operator: SeparatedOperator, displacement: SeparatedField,
                    mode: SeparatedField, *, along_y: bool, loss: float) -> SeparatedField:
    """Find all functions of one direction anew, those of the other direction and of a new mode kept.

    One banded system couples all modes and both components. The functions kept are made orthogonal first, by which
    ``loss`` of RMS displacement, pixels, may be lost. Functions of y are found anew if ``along_y``, those of x
    otherwise; ``operator`` includes its weight. Raises SingularSubdomainError where the images do not determine the
    functions.
    """
    line, other = (mode.along_y, mode.along_x) if along_y else (mode.along_x, mode.along_y)
    functions = pixels.reference.sums.broadcast(_choose_functions(displacement, mode, along_y=along_y))
    data, right = pixels.integrate_pairs(other.evaluate_at_pixels(functions), along_y=along_y)
    oriented = operator.transpose() if along_y else operator
    blocks = _assemble_blocks(line, data)
    if len(oriented.rows):
        # Blocks of no term would take as much memory.
        blocks = add_diagonals(blocks, _couple(oriented, functions))
    given = (displacement.y, displacement.scaled_x) if along_y else (displacement.scaled_x, displacement.y)
    vector = np.stack([line.sum_at_nodes(row) for row in right]) - _regularize(oriented, functions, *given)
    found = solve_coupled(blocks, vector, "update of one direction").reshape(-1, 2, line.n_nodes)
    x, y = (functions, found) if along_y else (found, functions)
    corrected = displacement.add(scale_modes(mode.along_x, mode.along_y, x, y))
    return pixels.reference.sums.broadcast(corrected.reduce_modes(loss))


def _choose_functions(displacement: SeparatedField, mode: SeparatedField, *, along_y: bool) -> Array:
    """Orthonormal functions of the direction that is kept (m, 2, n): of large modes, and of the new one in any case.

    The sum of both is no way to choose: what the mode takes away from the displacement would look small in it.
    """
    large = displacement.reduce_modes(NEGLECTED * float(mode.measure_rms().max()))
    line = mode.along_x if along_y else mode.along_y
    given = np.concatenate([(large.x if along_y else large.y)[:MOST_RENEWED - 1], mode.x if along_y else mode.y])
    chosen = []
    for c in range(2):
        functions, r = orthonormalize(line, given[:, c])
        chosen.append(functions[np.abs(np.diag(r)) > DEPENDENT])
    return join_components(chosen)


def _couple(operator: SeparatedOperator, functions: Array) -> Array:
    """What regularisation couples: (m, m, 2 w + 1, n), function k of component c being m = 2 k + c."""
    n_modes, width, n = len(functions), operator.x.shape[1], operator.x.shape[2]
    blocks = np.zeros((n_modes, 2, n_modes, 2, width, n))
    for c, d in product(range(2), repeat=2):
        chosen = np.flatnonzero((operator.rows == c) & (operator.columns == d))
        if len(chosen):
            weights = np.stack([functions[:, c] @ multiply(operator.y[t], functions[:, d]).T for t in chosen])
            blocks[:, c, :, d] = np.tensordot(weights, operator.x[chosen], axes=(0, 0))
    return blocks.reshape(2 * n_modes, 2 * n_modes, width, n)


def _regularize(operator: SeparatedOperator, functions: Array, x: Array, y: Array) -> Array:
    """L u against functions (n_modes, 2, n_other), (m, n); u: functions x and y of its modes."""
    of_x, of_y = operator.apply(x, y)
    total = np.zeros((len(functions), 2, operator.x.shape[2]))
    for t, c in enumerate(operator.rows):
        total[:, c] += (functions[:, c] @ of_y[t].T) @ of_x[t]
    return total.reshape(-1, total.shape[2])
