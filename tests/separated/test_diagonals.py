"""Matrices by their diagonals against dense ones."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.errors import SingularSubdomainError
from ddic.separated.field import add_diagonals, multiply, multiply_matrices, pad_diagonals, solve_coupled, transpose
from support.separated import dense

N = 9


def _random(width: int, seed: int) -> np.ndarray:
    """Diagonals, entries beyond the matrix zero."""
    bands = np.random.default_rng(seed).normal(size=(2 * width + 1, N))
    for k in range(1, width + 1):
        bands[width + k, N - k:] = 0.0
        bands[width - k, :k] = 0.0
    return bands


@pytest.mark.parametrize(("of_left", "of_right"), [(1, 1), (1, 2), (2, 1), (0, 2)])
def test_products_and_sums_are_those_of_dense_matrices(of_left: int, of_right: int) -> None:
    left, right = _random(of_left, 0), _random(of_right, 1)
    v = np.random.default_rng(2).normal(size=N)
    assert np.allclose(multiply(left, v), dense(left) @ v, rtol=0, atol=1e-14)
    assert np.allclose(dense(multiply_matrices(left, right)), dense(left) @ dense(right), rtol=0, atol=1e-14)
    assert np.array_equal(dense(transpose(left)), dense(left).T)
    assert np.array_equal(dense(add_diagonals(left, right)), dense(left) + dense(right))
    assert np.array_equal(dense(pad_diagonals(left, 3)), dense(left))


@pytest.mark.parametrize("m", [2, 4])
@pytest.mark.parametrize("width", [1, 2])
def test_coupled_system_is_solved_as_a_dense_one(m: int, width: int) -> None:
    random = np.random.default_rng(3)
    blocks = np.stack([np.stack([_random(width, 10 * c + d) for d in range(m)]) for c in range(m)])
    matrix = np.zeros((N, m, N, m))
    for c in range(m):
        for d in range(m):
            symmetric = dense(blocks[c, d]) + dense(blocks[d, c]).T
            matrix[:, c, :, d] = symmetric + (10.0 * m * np.eye(N) if c == d else 0.0)
    full = np.zeros_like(blocks)
    for c in range(m):
        for d in range(m):
            for k in range(-width, width + 1):
                for i in range(max(0, -k), min(N, N - k)):
                    full[c, d, width + k, i] = matrix[i, c, i + k, d]
    right = random.normal(size=(m, N))
    expected = np.linalg.solve(matrix.reshape(N * m, N * m), right.T.ravel()).reshape(N, m).T
    # A well conditioned matrix of 36 rows.
    assert np.allclose(solve_coupled(full, right, "test"), expected, rtol=0, atol=1e-13)


def test_indefinite_system_is_refused() -> None:
    blocks = np.zeros((2, 2, 3, N))
    with pytest.raises(SingularSubdomainError, match="test: the images do not determine its functions"):
        solve_coupled(blocks, np.ones((2, N)), "test")
