"""What is left of a symmetric matrix with its first unknowns eliminated."""

from __future__ import annotations

import numpy as np
import pytest
from petsc4py import PETSc
from scipy import sparse

from ddic.solvers.petsc import can_eliminate, eliminate


@pytest.mark.parametrize(("n", "n_left"), [(1, 1), (30, 1), (30, 12), (5, 40)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_is_left_is_the_schur_complement(n: int, n_left: int, sign: float) -> None:
    assert can_eliminate()
    rng = np.random.default_rng(0)
    root = rng.normal(size=(n, n))
    a, b = root @ root.T + n * np.eye(n), rng.normal(size=(n, n_left))
    c = sign * np.eye(n_left)
    upper = sparse.csr_matrix(np.triu(np.block([[a, b], [b.T, c]])))
    matrix = PETSc.Mat().createSBAIJ(upper.shape, 1, csr=(upper.indptr, upper.indices, upper.data),
                                     comm=PETSc.COMM_SELF)
    found = eliminate(matrix, n)
    matrix.destroy()
    expected = c - b.T @ np.linalg.solve(a, b)
    # Rounding: the condition number of a is below 10.
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * np.abs(expected).max())
    np.testing.assert_array_equal(found, found.T)
