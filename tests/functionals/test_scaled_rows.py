"""Rows of a sparse matrix times numbers."""

import numpy as np
import pytest
from scipy import sparse

from ddic.functionals import regularization as module
from ddic.functionals.regularization import scale_rows, sum_column_squares


def test_rows_are_scaled_as_by_a_diagonal_matrix_and_the_matrix_stays() -> None:
    matrix = sparse.random(7, 5, density=0.4, format="csr", random_state=0)
    before = matrix.toarray()
    factors = np.arange(7) - 2.0
    np.testing.assert_array_equal(scale_rows(matrix, factors).toarray(), factors[:, None] * before)
    np.testing.assert_array_equal(matrix.toarray(), before)


@pytest.mark.parametrize("rows_at_once", [1, 3, 100])
def test_squares_of_columns_are_those_of_the_matrix_squared(rows_at_once: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "ROWS_AT_ONCE", rows_at_once)
    random = np.random.default_rng(0)
    matrix = sparse.random(11, 7, 0.3, format="csr", random_state=random)
    # A row, and a column, without entries.
    matrix = sparse.vstack([matrix, sparse.csr_matrix((1, 7)), matrix]).tocsr()
    factors = random.normal(size=matrix.shape[0])
    expected = (matrix.toarray() ** 2 * factors[:, None] ** 2).sum(axis=0)
    np.testing.assert_allclose(sum_column_squares(matrix, factors), expected, rtol=1e-14)
