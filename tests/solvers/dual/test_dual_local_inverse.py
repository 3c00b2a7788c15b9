"""S_s^-1 as an array and as a sparse factor: the same numbers, and which of them is chosen."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy import sparse

from ddic.errors import SingularSubdomainError, is_collective
from ddic.parallel.team import Team
from ddic.partition.subdomain import Weighting
from ddic.solvers.dual import preconditioner
from ddic.solvers.dual.dual_problem import LocalDual, PackedSymmetric
from ddic.solvers.dual.dual_step import DualSettings
from ddic.solvers.dual.preconditioner import (
    DENSE_ARRAYS,
    DENSE_LIMIT,
    LocalInverseKind,
    Preconditioner,
    SparseInverse,
    assemble_schur,
    build_preconditioner,
    build_schur_pair,
    invert_by_blocks,
    is_dense,
)
from ddic.solvers.petsc import PetscStack
from support.linear import Decomposed, dense, linear_step, split

KINDS: list[LocalInverseKind] = ["dense", "sparse"]


@pytest.mark.parametrize("weighting", ["consistent", "paper"])
@pytest.mark.parametrize("wavelength", [None, 32.0, 128.0])
@pytest.mark.parametrize("kind", ["blocks", "metis"])
def test_both_ways_invert_the_same_operator(kind: str, wavelength: float | None, weighting: Weighting) -> None:
    problem = linear_step(10, wavelength)
    rng = np.random.default_rng(0)
    with Decomposed(Team.alone(), problem, split(problem.mesh, kind, 4), weighting) as cut:
        _, locals_ = cut.interface()
        for local in locals_:
            block = rng.normal(size=(len(local.compliance), 3))
            found = []
            for way in KINDS:
                schur, inverse = build_schur_pair(local, way)
                multiply = local.multiply_schur if schur is None else schur.apply_to_columns
                x = np.stack([inverse.apply(r) for r in block.T], axis=1)
                # S_s S_s^-1 = I up to rounding times the condition number of S_s, 1e5 at most here; arrays are in
                # single precision, whose rounding is 6e-8.
                np.testing.assert_allclose(multiply(x), block, rtol=0, atol=1e-9 if way == "sparse" else 6e-3)
                found.append((x, multiply(block)))
                inverse.destroy()
            for by_array, by_factor, rounding in zip(*found, (1e-6, 1e-9), strict=True):
                np.testing.assert_allclose(by_factor, by_array, rtol=0, atol=rounding * np.abs(by_array).max())


def test_a_subdomain_without_jumps_is_inverted_without_a_word(capfd: pytest.CaptureFixture[str]) -> None:
    schur = -np.array([[2.0, 1.0], [1.0, 3.0]])
    # Rounding of a matrix of condition 2.6.
    np.testing.assert_allclose(invert_by_blocks(schur, 0), np.linalg.inv(schur), rtol=1e-15)
    assert "".join(capfd.readouterr()) == ""


def test_a_solution_is_not_changed_by_the_next_one() -> None:
    problem = linear_step(8, 32.0)
    with Decomposed(Team.alone(), problem, split(problem.mesh, "blocks", 4), "consistent") as cut:
        local = cut.interface()[1][0]
        inverse = SparseInverse(local)
        r = np.random.default_rng(0).normal(size=len(local.compliance))
        first = inverse.apply(r)
        kept = first.copy()
        inverse.apply(-r)
        again = inverse.apply(r)
        inverse.destroy()
    np.testing.assert_array_equal(first, kept)
    np.testing.assert_array_equal(first, again)


@pytest.mark.parametrize("wavelength", [None, 32.0])
@pytest.mark.parametrize("block", [1, 7, 256])
def test_schur_product_in_blocks_of_any_size(block: int, wavelength: float | None,
                                             monkeypatch: pytest.MonkeyPatch) -> None:
    problem = linear_step(8, wavelength)
    with Decomposed(Team.alone(), problem, split(problem.mesh, "blocks", 4), "consistent") as cut:
        local, system = cut.interface()[1][0], cut.systems[0]
        monkeypatch.setattr(type(local.operator), "block", block)
        t = dense(local.trace)
        expected = t @ np.linalg.solve(dense(system.operator), t.T) - np.diag(local.compliance)
        # Rounding times the condition number of A_s, about 1e3.
        found = local.multiply_schur(np.eye(len(local.compliance)))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * np.abs(expected).max())


def test_schur_complement_is_the_same_without_elimination(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = linear_step(8, 32.0)
    with Decomposed(Team.alone(), problem, split(problem.mesh, "blocks", 4), "consistent") as cut:
        local = cut.interface()[1][0]
        monkeypatch.setattr(preconditioner, "ELIMINATED_FROM", 0)
        eliminated = assemble_schur(local)
        monkeypatch.setattr(preconditioner, "can_eliminate", lambda: False)
        # Rounding times the condition number of A_s, about 1e3.
        np.testing.assert_allclose(assemble_schur(local), eliminated, rtol=0, atol=1e-11 * np.abs(eliminated).max())


def _with_trace(local: LocalDual, row: np.ndarray | None) -> LocalDual:
    trace = local.trace.tolil()
    trace[1] = 0.0 if row is None else row
    return dataclasses.replace(local, trace=sparse.csr_matrix(trace))


@pytest.mark.parametrize("defect", ["the same row twice", "an empty row", "no compliance"])
@pytest.mark.parametrize("way", KINDS)
def test_a_singular_or_wrongly_signed_operator_is_refused(way: LocalInverseKind, defect: str) -> None:
    # The first two allowed S_s a null vector; without D_s the block of the reactions is positive definite, which no
    # factorisation minds and only the inertia tells.
    problem = linear_step(8, 32.0)
    with Decomposed(Team.alone(), problem, split(problem.mesh, "blocks", 4), "consistent") as cut:
        local = cut.interface()[1][0]
        broken = {
            "the same row twice": _with_trace(local, local.trace[0].toarray()),
            "an empty row": _with_trace(local, None),
            "no compliance": dataclasses.replace(local, compliance=0.0 * local.compliance),
        }[defect]
        with pytest.raises(SingularSubdomainError, match="interface problem of a subdomain is singular"):
            build_schur_pair(broken, way)


def test_the_choice_follows_the_memory_of_the_arrays() -> None:
    largest = int(np.sqrt(DENSE_LIMIT / (8 * DENSE_ARRAYS)))
    assert is_dense(largest, "auto")
    assert not is_dense(largest + 1, "auto")
    assert is_dense(100 * largest, "dense")
    assert not is_dense(1, "sparse")


def test_the_step_holds_what_was_chosen() -> None:
    step = linear_step(8, 32.0)
    with Decomposed(Team.alone(), step, split(step.mesh, "blocks", 4), "consistent") as cut:
        problem, held = cut.dual_problem(), {}
        for kind in ("auto", "dense", "sparse"):
            with PetscStack() as stack:
                one_level, _ = build_preconditioner(stack, problem, "scaled", kind)
                held[kind] = {type(inverse) for inverse in one_level.inverses}
    assert held == {"auto": {PackedSymmetric}, "dense": {PackedSymmetric}, "sparse": {SparseInverse}}


@pytest.mark.parametrize(("precision", "rounding"), [(np.float32, 1e-6), (np.float64, 1e-14)])
@pytest.mark.parametrize("n", [0, 1, 40])
def test_a_packed_array_multiplies_in_its_precision(n: int, precision: type, rounding: float) -> None:
    array = np.random.default_rng(0).normal(size=(n, n))
    array += array.T
    columns = np.random.default_rng(1).normal(size=(n, 3))
    packed = PackedSymmetric(array.astype(precision))
    expected = array @ columns
    # Single precision has 6e-8, double 1e-16; sums of tens of terms below the largest here.
    for found in (np.stack([packed.apply(x) for x in columns.T], axis=1), packed.apply_to_columns(columns)):
        np.testing.assert_allclose(found, expected, rtol=0, atol=rounding * np.abs(expected).max(initial=0.0))


@pytest.mark.parametrize("wavelength", [None, 32.0])
def test_products_with_arrays_are_those_by_local_solves(wavelength: float | None) -> None:
    step = linear_step(10, wavelength)
    with Decomposed(Team.alone(), step, split(step.mesh, "blocks", 4), "consistent") as cut, PetscStack() as stack:
        problem = cut.dual_problem()
        v = np.random.default_rng(0).normal(size=len(problem.exchange.ghosts))
        by_solves = problem.operator.apply_own(v)
        build_preconditioner(stack, problem, "scaled", "dense")
        by_arrays = problem.operator.apply_own(v)
    assert not np.array_equal(by_arrays, by_solves)
    # Rounding times the condition number of A_s, about 1e3.
    np.testing.assert_allclose(by_arrays, by_solves, rtol=0, atol=1e-11 * np.abs(by_solves).max())


@pytest.mark.parallel([1, 2, 3, 4])
@pytest.mark.parametrize("wavelength", [None, 32.0])
@pytest.mark.parametrize("preconditioner", ["paper", "scaled", "two_level"])
def test_dense_and_sparse_give_the_same_field(preconditioner: Preconditioner, wavelength: float | None) -> None:
    problem = linear_step(wavelength=wavelength)
    with Decomposed(Team.world(), problem, split(problem.mesh, "metis", 9), "consistent") as cut:
        results = [cut.solve(cut.step(DualSettings(preconditioner, 1e-12, 3000, local_inverse=kind)))
                   for kind in KINDS]
        scale = max(float(np.abs(d).max()) for d in results[0].dq)
        difference = max(float(np.abs(a - b).max()) for a, b in zip(results[0].dq, results[1].dq, strict=True))
        difference, scale = (cut.team.maximum(x) for x in (difference, scale))
    # Both residuals are 1e-12 of the right-hand side and S_tot's condition number stays below 1e3.
    assert difference <= 1e-9 * scale
    # The same preconditioner but for rounding; one iteration of slack at the threshold.
    assert abs(results[0].krylov_iterations - results[1].krylov_iterations) <= 1


@pytest.mark.parallel([1, 2, 3, 4])
def test_a_singular_inverse_of_one_rank_raises_on_all(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = linear_step(wavelength=32.0)
    with Decomposed(Team.world(), problem, split(problem.mesh, "metis", 9), "consistent") as cut:
        healthy = SparseInverse._check_inertia
        if cut.team.rank == cut.team.size - 1:
            monkeypatch.setattr(SparseInverse, "_check_inertia", lambda self, n: healthy(self, n + 1))
        with pytest.raises(SingularSubdomainError) as caught:
            cut.step(DualSettings(local_inverse="sparse"))
    assert is_collective(caught.value)
