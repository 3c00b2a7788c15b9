"""The factorised local operator."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from petsc4py import PETSc
from scipy import sparse

from ddic.errors import FactorizationError, SingularSubdomainError
from ddic.solvers import petsc
from ddic.solvers.local_system import MISSING_PACKAGE, OUT_OF_MEMORY, ZERO_PIVOT, LocalOperator, describe_failure

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


@pytest.mark.parametrize(("package", "kind"), [("mumps", "mumps"), ("petsc", "seqsbaij")])
def test_the_factorisation_follows_petsc_options(package: str, kind: str) -> None:
    options = PETSc.Options()
    key = "local_pc_factor_mat_solver_type"
    before = options.getString(key, "cholmod")
    options.setValue(key, package)
    try:
        operator = LocalOperator(_positive_definite(), smallest_eigenvalue=1e-9, where="here")
        x = np.ones(N)
        np.testing.assert_allclose(operator.solve(_positive_definite() @ x), x, rtol=0, atol=1e-12)
        assert operator._factor.getType() == kind
        operator.destroy()
    finally:
        options.setValue(key, before)


@pytest.fixture
def package_option() -> Iterator[str]:
    """Name of the option, which is as before afterwards."""
    name = "local_pc_factor_mat_solver_type"
    options = PETSc.Options()
    before = options.getString(name, "")
    options.delValue(name)
    yield name
    options.delValue(name)
    if before:
        options.setValue(name, before)


def test_a_solver_package_that_petsc_has_not_is_no_want_of_texture(package_option: str) -> None:
    PETSc.Options().setValue(package_option, "no_such_package")
    with pytest.raises(FactorizationError, match=r"subdomain 3: .*no_such_package.*solver_type mumps") as caught:
        LocalOperator(_positive_definite(), smallest_eigenvalue=1e-9, where="subdomain 3")
    assert "texture" not in str(caught.value)


@pytest.mark.parametrize(("number", "kind", "told"), [
    (OUT_OF_MEMORY, FactorizationError, "not enough memory"),
    (MISSING_PACKAGE, FactorizationError, "solver package"),
    (ZERO_PIVOT[1], SingularSubdomainError, "too little texture"),
    (76, FactorizationError, "PETSc's error 76"),
])
def test_every_failure_has_a_message_of_its_own(number: int, kind: type[Exception], told: str) -> None:
    failure = describe_failure(PETSc.Error(number), "subdomain 3")
    assert type(failure) is kind
    assert str(failure).startswith("subdomain 3: ")
    assert told in str(failure)


@pytest.mark.parametrize(("there", "chosen"), [
    ({"suitesparse", "mumps"}, "cholmod"), ({"cholmod"}, "cholmod"), ({"mumps"}, "mumps"), (set(), "petsc")])
def test_without_cholmod_another_package_is_taken_and_told(there: set[str], chosen: str, package_option: str,
                                                           monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(petsc, "has_package", there.__contains__)
    operator = LocalOperator(_positive_definite(), smallest_eigenvalue=1e-9, where="here")
    assert PETSc.Options().getString(package_option) == chosen
    x = np.random.default_rng(1).normal(size=N)
    np.testing.assert_allclose(operator.solve(_positive_definite() @ x), x, rtol=0, atol=1e-12)
    operator.destroy()
    notes = petsc.describe_missing_packages("monolithic")
    assert len(notes) == (chosen != "cholmod")
    assert all(chosen in note for note in notes)
    # Who asks for a package of their own is told nothing.
    PETSc.Options().setValue(package_option, "another")
    assert petsc.describe_missing_packages("monolithic") == ()
