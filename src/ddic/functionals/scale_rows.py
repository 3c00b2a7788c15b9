"""Rows of a sparse matrix times numbers."""

import numpy as np
from scipy import sparse

from ddic.arrays import Array


def scale_rows(matrix: sparse.csr_matrix, factors: Array) -> sparse.csr_matrix:
    """Multiply every row by a number, the matrix itself staying as it is.

    A product with a diagonal matrix takes ten times as long on a small matrix.
    """
    scaled = matrix.copy()
    scaled.data *= np.repeat(factors, np.diff(matrix.indptr))
    return scaled
