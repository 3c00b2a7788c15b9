"""The best rank-one correction by alternating directions, Fig. 2 and Eq. (19)-(24) of [PP12]."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.separated.diagonals import add_up, solve_coupled
from ddic.separated.line_elements import LineElements
from ddic.separated.pixel_bands import FramePixels
from ddic.separated.separated_field import SeparatedField, scale_modes
from ddic.separated.separated_regularization import SeparatedOperator

Array = NDArray[np.float64]

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
        From values of the given functions at pixels (2, n_other) to the integrals of Eq. (19), (5, n_pixels).
    operator : SeparatedOperator or None
        Regularisation, weight included, its x along ``line``.
    of_line, of_other : (n_terms, n_modes, n) array
        What its matrices make of the field so far, along both directions.
    name : str
        Of the direction, for messages.
    """

    line: LineElements
    other: LineElements
    integrate: Callable[[Array], Array]
    operator: SeparatedOperator | None
    of_line: Array
    of_other: Array
    name: str

    def solve(self, given: Array) -> tuple[Array, float]:
        """Find both components' functions, coupled: Eq. (19)-(21) of [PP12].

        Parameters
        ----------
        given : (2, n_other) array
            Functions of the other direction at its nodes.

        Returns
        -------
        functions : (2, n) array
            At the nodes.
        gain : float
            By how much the correction lowers half the sum of squared residuals with its regularisation, grey levels
            squared.
        """
        sums = self.integrate(self.other.evaluate_at_pixels(given))
        xx, xy, yy = (self.line.assemble(row) for row in sums[:3])
        blocks = np.stack([np.stack([xx, xy]), np.stack([xy, yy])])
        blocks = blocks + hold_nodes(self.line, blocks)
        right = np.stack([self.line.sum_at_nodes(row) for row in sums[3:]])
        if self.operator is not None:
            weights = self.operator.reduce(given, given)
            blocks = add_up([blocks, self.operator.assemble(weights)])
            right = right - self._regularize(given)
        functions = solve_coupled(blocks, right, f"correction along {self.name}")
        return functions, 0.5 * float((right * functions).sum())

    def _regularize(self, given: Array) -> Array:
        """L u against the given functions, (2, n)."""
        operator = self.operator
        if operator is None or not self.of_line.shape[1]:
            return np.zeros((2, self.line.n_nodes))
        products = np.einsum("ti,tki->tk", given[operator.rows], self.of_other)
        of_terms = np.einsum("tk,tki->ti", products, self.of_line)
        return np.stack([of_terms[operator.rows == c].sum(axis=0) for c in range(2)])


def hold_nodes(line: LineElements, blocks: Array) -> Array:
    """Give what holds the nodes that no pixel shows.

    Parameters
    ----------
    line : LineElements
        Of the functions sought.
    blocks : (m, m, 3, n) array
        What pixels give, by the functions that it couples.

    Returns
    -------
    (m, m, 3, n) array
        Diagonal in the functions.
    """
    every = np.arange(len(blocks))
    scale = HELD * float(blocks[every, every, 1].mean()) / float(line.stiffness[1].mean())
    held = scale * line.stiffness
    held[1] += ANCHORED * held[1].mean()
    diagonal = np.zeros_like(blocks)
    diagonal[every, every] = held
    return diagonal


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
    """

    field: SeparatedField
    gain: float
    n_sweeps: int


def build_directions(pixels: FramePixels, operator: SeparatedOperator | None,
                     displacement: SeparatedField) -> tuple[Direction, Direction]:
    """Set up both halves of the fixed point at a displacement.

    Parameters
    ----------
    pixels : FramePixels
        With the residual there.
    operator : SeparatedOperator or None
        Regularisation, weight included.
    displacement : SeparatedField
        u.

    Returns
    -------
    along_x, along_y : Direction
        For functions of x, and of y.
    """
    x, y = pixels.reference.along_x, pixels.reference.along_y
    none = np.zeros((0, 0, 0))
    of_x, of_y = (none, none) if operator is None else operator.apply(displacement.scaled_x, displacement.y)
    swapped = None if operator is None else operator.transpose()
    return (Direction(x, y, pixels.integrate_over_y, operator, of_x, of_y, "x"),
            Direction(y, x, pixels.integrate_over_x, swapped, of_y, of_x, "y"))


def find_rank_one(pixels: FramePixels, directions: tuple[Direction, Direction], max_sweeps: int,
                  stagnation: float) -> Mode:
    """Find the rank-one correction that fits the residual best.

    Parameters
    ----------
    pixels : FramePixels
        With the residual.
    directions : tuple of Direction
        Of x and of y, at the same displacement.
    max_sweeps : int
        k_max, of both directions each.
    stagnation : float
        e: change of the correction from sweep to sweep, relative to it, at which it is taken.

    Returns
    -------
    Mode
        The correction.
    """
    along_x, along_y = directions
    broadcast = pixels.reference.sums.broadcast
    y = estimate_functions(pixels)
    before: SeparatedField | None = None
    n_sweeps = 0
    while n_sweeps < max_sweeps:
        n_sweeps += 1
        x, _ = broadcast(along_x.solve(y))
        y, gain = broadcast(along_y.solve(_scale(x)))
        mode = scale_modes(along_x.line, along_y.line, _scale(x)[None], y[None])
        if before is not None and broadcast(_change(before, mode) <= stagnation):
            break
        before, y = mode, _scale(y)
    return Mode(mode, gain, n_sweeps)


def estimate_functions(pixels: FramePixels) -> Array:
    """Guess functions of y from the residual in blocks.

    Parameters
    ----------
    pixels : FramePixels
        With the residual.

    Returns
    -------
    (2, n_y) array
        Of both components: what changes most from block to block, by singular value decompositions.
    """
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


def _block_edges(line: LineElements) -> NDArray[np.int64]:
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
