"""Rows of a sparse matrix times numbers."""

import numpy as np
from scipy import sparse

from ddic.functionals.scale_rows import scale_rows


def test_rows_are_scaled_as_by_a_diagonal_matrix_and_the_matrix_stays() -> None:
    matrix = sparse.random(7, 5, density=0.4, format="csr", random_state=0)
    before = matrix.toarray()
    factors = np.arange(7) - 2.0
    np.testing.assert_array_equal(scale_rows(matrix, factors).toarray(), factors[:, None] * before)
    np.testing.assert_array_equal(matrix.toarray(), before)
