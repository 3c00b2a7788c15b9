"""All functions of one direction found anew, those of the other direction kept."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from ddic.separated.diagonals import add_up, multiply, solve_coupled
from ddic.separated.line_elements import LineElements
from ddic.separated.pixel_bands import FramePixels
from ddic.separated.rank_one import hold_nodes
from ddic.separated.separated_field import SeparatedField, orthonormalize, scale_modes
from ddic.separated.separated_regularization import SeparatedOperator

Array = NDArray[np.float64]

NEGLECTED = 0.1
"""RMS of the modes whose functions are left as they are, relative to the new mode's. A smaller value takes the square
of the number of functions in time and memory, and no fewer corrections: 1e-3 takes as many as 0.1."""


MOST_RENEWED = 24
"""Functions of each component that are found anew at once, the new one and those of the largest modes: memory and time
grow with their square, to 0.4 GB for an image 10,000 px wide."""

DEPENDENT = 1e-6
"""Part of a function, of mean square 1, that is not made of those before it, below which it is left out."""


def renew_functions(pixels: FramePixels, operator: SeparatedOperator | None, displacement: SeparatedField,
                     mode: SeparatedField, *, along_y: bool, loss: float) -> SeparatedField:
    """Find all functions of one direction anew, those of the other direction and of a new mode kept.

    One banded system couples all modes and both components. The functions kept are made orthogonal first.

    Parameters
    ----------
    pixels : FramePixels
        With the residual at the displacement.
    operator : SeparatedOperator or None
        Regularisation, weight included.
    displacement : SeparatedField
        u.
    mode : SeparatedField
        The correction that brings a new function to keep.
    along_y : bool
        Whether functions of y are found anew, not those of x.
    loss : float
        RMS displacement that making functions orthogonal may lose, pixels.

    Returns
    -------
    SeparatedField
        u with the correction that is best for these functions.

    Raises
    ------
    SingularSubdomainError
        Where the images do not determine the functions.
    """
    line, other = (mode.along_y, mode.along_x) if along_y else (mode.along_x, mode.along_y)
    functions = pixels.reference.sums.broadcast(_choose_functions(displacement, mode, along_y=along_y))
    data, right = pixels.integrate_pairs(other.evaluate_at_pixels(functions), along_y=along_y)
    blocks = _assemble_blocks(line, data)
    blocks = blocks + hold_nodes(line, blocks)
    vector = np.stack([line.sum_at_nodes(row) for row in right])
    if operator is not None:
        oriented = operator.transpose() if along_y else operator
        blocks = add_up([blocks, _couple(oriented, functions)])
        given = (displacement.y, displacement.scaled_x) if along_y else (displacement.scaled_x, displacement.y)
        vector = vector - _regularize(oriented, functions, *given)
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
    n_functions = max(len(functions) for functions in chosen)
    return np.stack([np.pad(functions, ((0, n_functions - len(functions)), (0, 0))) for functions in chosen], axis=1)


def _assemble_blocks(line: LineElements, data: Array) -> Array:
    """Matrices between all functions from their integrals at pixels (m, m, n_pixels), (m, m, 3, n)."""
    m = len(data)
    blocks = np.empty((m, m, 3, line.n_nodes))
    for row in range(m):
        for column in range(row, m):
            blocks[row, column] = blocks[column, row] = line.assemble(data[row, column])
    return blocks


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
