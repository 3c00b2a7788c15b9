"""The factorised local operator."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from petsc4py import PETSc
from scipy import sparse

from ddic.errors import SingularSubdomainError
from ddic.solvers.local_operator import LocalOperator

N = 40


def _positive_definite(n: int = N) -> sparse.csr_matrix:
    """A random sparse matrix with eigenvalues between 1 and about 10."""
    factor = sparse.random(n, n, density=0.1, random_state=np.random.default_rng(0))
    return (factor @ factor.T + sparse.identity(n)).tocsr()


def _path_graph(n: int = N) -> sparse.csr_matrix:
    """Laplacian of a chain: positive semi-definite with the constants as null space."""
    matrix = sparse.diags([-np.ones(n - 1), 2 * np.ones(n), -np.ones(n - 1)], [-1, 0, 1]).tolil()
    matrix[0, 0] = matrix[n - 1, n - 1] = 1.0
    return matrix.tocsr()


@pytest.fixture
def operator() -> Iterator[LocalOperator]:
    operator = LocalOperator(_positive_definite(), smallest_eigenvalue=1e-9, where="here")
    yield operator
    operator.destroy()


def test_solves_one_right_hand_side(operator: LocalOperator) -> None:
    x = np.random.default_rng(1).normal(size=N)
    # Condition number about 10: a few roundings.
    np.testing.assert_allclose(operator.solve(_positive_definite() @ x), x, rtol=0, atol=1e-13)


@pytest.mark.parametrize("columns", [0, 1, 3, 300])
def test_solves_many_right_hand_sides_like_one_at_a_time(operator: LocalOperator, columns: int) -> None:
    right = np.random.default_rng(2).normal(size=(N, columns))
    kept = right.copy()
    solution = operator.solve_many(right)
    assert solution.shape == (N, columns)
    for column in range(columns):
        np.testing.assert_allclose(solution[:, column], operator.solve(right[:, column]), rtol=0, atol=1e-13)
    np.testing.assert_array_equal(right, kept)


def test_a_solution_is_not_changed_by_the_next_one(operator: LocalOperator) -> None:
    first = operator.solve(np.ones(N))
    kept = first.copy()
    operator.solve(np.arange(N, dtype=float))
    np.testing.assert_array_equal(first, kept)


@pytest.mark.parametrize(("name", "matrix"), [
    ("exactly singular", _path_graph()),
    ("zero", sparse.csr_matrix((N, N))),
    ("an empty row", sparse.diags(np.r_[np.ones(N - 1), 0.0]).tocsr()),
    ("nearly singular", (_path_graph() + 1e-13 * sparse.identity(N)).tocsr()),
    ("not finite", (sparse.identity(N) * np.nan).tocsr()),
])
def test_a_singular_matrix_is_refused_by_name(name: str, matrix: sparse.csr_matrix) -> None:
    with pytest.raises(SingularSubdomainError, match=r"^subdomain 7: .*too little texture.*cut_off_wavelength"):
        LocalOperator(matrix, smallest_eigenvalue=1e-9, where="subdomain 7")


@pytest.mark.parametrize(("smallest", "accepted"), [(0.9e-3, True), (1.1e-3, False)])
def test_the_lowest_eigenvalue_decides(smallest: float, accepted: bool) -> None:
    # One eigenvalue of 1e-3 below 1 to 2: inverse iteration finds it to a millionth in three rounds.
    matrix = sparse.diags(np.r_[1e-3, np.linspace(1, 2, N - 1)]).tocsr()
    if accepted:
        LocalOperator(matrix, smallest_eigenvalue=smallest, where="here").destroy()
    else:
        with pytest.raises(SingularSubdomainError):
            LocalOperator(matrix, smallest_eigenvalue=smallest, where="here")


@pytest.mark.parametrize("package", ["mumps", "petsc"])
def test_the_factorisation_follows_petsc_options(package: str) -> None:
    options = PETSc.Options()
    key = "local_pc_factor_mat_solver_type"
    before = options.getString(key, "cholmod")
    options.setValue(key, package)
    try:
        operator = LocalOperator(_positive_definite(), smallest_eigenvalue=1e-9, where="here")
        x = np.ones(N)
        np.testing.assert_allclose(operator.solve(_positive_definite() @ x), x, rtol=0, atol=1e-12)
        assert operator._ksp.getPC().getFactorSolverType() == package
        operator.destroy()
    finally:
        options.setValue(key, before)
