"""Matrices of one-dimensional problems by their diagonals: entry [w + k, i] of (2 w + 1, n) couples i to i + k."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from ddic.errors import SingularSubdomainError

Array = NDArray[np.float64]


def multiply(bands: Array, vectors: Array) -> Array:
    """Multiply matrices by vectors.

    Parameters
    ----------
    bands : (..., 2 w + 1, n) array
        Matrices.
    vectors : (..., n) array
        Vectors, of leading axes that broadcast with the matrices'.

    Returns
    -------
    (..., n) array
        Products.
    """
    width, n = bands.shape[-2] // 2, bands.shape[-1]
    product = bands[..., width, :] * vectors
    for k in range(1, min(width, n - 1) + 1):
        product[..., :-k] += bands[..., width + k, :-k] * vectors[..., k:]
        product[..., k:] += bands[..., width - k, k:] * vectors[..., :-k]
    return np.asarray(product)


def multiply_matrices(left: Array, right: Array) -> Array:
    """Multiply two matrices.

    Parameters
    ----------
    left, right : (2 w + 1, n) array
        Of one width w or two.

    Returns
    -------
    (2 (w + w') + 1, n) array
        left right.
    """
    of_left, of_right, n = len(left) // 2, len(right) // 2, left.shape[1]
    width = of_left + of_right
    product = np.zeros((2 * width + 1, n))
    for k in range(-of_left, of_left + 1):
        for m in range(-of_right, of_right + 1):
            rows = np.arange(max(0, -k, -k - m), min(n, n - k, n - k - m))
            product[width + k + m, rows] += left[of_left + k, rows] * right[of_right + m, rows + k]
    return product


def transpose(bands: Array) -> Array:
    """Transpose a matrix.

    Parameters
    ----------
    bands : (2 w + 1, n) array
        A matrix.

    Returns
    -------
    (2 w + 1, n) array
        Its transpose.
    """
    width, n = len(bands) // 2, bands.shape[1]
    turned = np.zeros_like(bands)
    for k in range(-width, width + 1):
        rows = np.arange(max(0, -k), min(n, n - k))
        turned[width - k, rows + k] = bands[width + k, rows]
    return turned


def pad_diagonals(bands: Array, width: int) -> Array:
    """Add empty diagonals.

    Parameters
    ----------
    bands : (..., 2 w + 1, n) array
        Matrices.
    width : int
        At least w.

    Returns
    -------
    (..., 2 width + 1, n) array
        The same matrices.
    """
    more = width - bands.shape[-2] // 2
    if not more:
        return bands
    return np.pad(bands, [(0, 0)] * (bands.ndim - 2) + [(more, more), (0, 0)])


def solve_coupled(blocks: Array, right: Array, what: str) -> Array:
    """Solve a symmetric positive definite system of several coupled functions along one direction.

    Parameters
    ----------
    blocks : (m, m, 2 w + 1, n) array
        Of functions c and d, the matrix that couples them.
    right : (m, n) array
        Right-hand sides.
    what : str
        Names the system in the message.

    Returns
    -------
    (m, n) array
        The functions at the nodes.

    Raises
    ------
    SingularSubdomainError
        Where the matrix is not positive definite.
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


def add_up(bands: Sequence[Array]) -> Array:
    """Add matrices of different widths.

    Parameters
    ----------
    bands : sequence of (..., 2 w + 1, n) array
        At least one.

    Returns
    -------
    (..., 2 w + 1, n) array
        Their sum, as wide as the widest.
    """
    width = max(matrix.shape[-2] // 2 for matrix in bands)
    total = pad_diagonals(bands[0], width)
    for matrix in bands[1:]:
        total = total + pad_diagonals(matrix, width)
    return total
