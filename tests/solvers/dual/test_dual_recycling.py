"""Recycled directions and inexact linear steps."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from ddic.parallel.team import Team
from ddic.solvers.dual.dual_step import LARGEST, DualSettings, RecycledSpace
from ddic.solvers.dual.preconditioner import Preconditioner
from ddic.solvers.linear_step import AllowedError
from support.linear import Decomposed, linear_step, one_domain_solution, split

RANKS = [1, 2, 3, 4]


def _mine(array: np.ndarray) -> np.ndarray:
    comm = MPI.COMM_WORLD
    return np.array_split(array, comm.size)[comm.rank]


@pytest.mark.parallel(RANKS)
def test_the_residual_over_kept_directions_is_least() -> None:
    random = np.random.default_rng(0)
    matrix, right = random.standard_normal((40, 40)), random.standard_normal(40)
    directions = random.standard_normal((40, 7))
    directions[:, 6] = directions[:, :3].sum(axis=1)  # a dependent one must do no harm
    space = RecycledSpace(Team.world(), len(_mine(right)))
    for part in (directions[:, :4], directions[:, 4:]):
        space.learn(_mine(part), _mine(matrix @ part))
    residual, solution = _mine(right).copy(), np.zeros(len(_mine(right)))
    space.reduce(residual, solution)
    residual, solution = (np.concatenate(MPI.COMM_WORLD.allgather(v)) for v in (residual, solution))
    best = np.linalg.lstsq(matrix @ directions, right, rcond=1e-10)[0]
    assert space.size == 6
    # Rounding times the condition of seven random directions.
    np.testing.assert_allclose(residual, right - matrix @ directions @ best, atol=1e-10)
    np.testing.assert_allclose(residual, right - matrix @ solution, atol=1e-10)


@pytest.mark.parallel([1])
def test_no_more_directions_are_kept_than_the_limit() -> None:
    n = LARGEST + 40
    space = RecycledSpace(Team.world(), n)
    space.learn(np.eye(n)[:, :60], np.eye(n)[:, :60])
    space.learn(np.eye(n)[:, 60:], np.eye(n)[:, 60:])
    assert space.size == LARGEST
    # The oldest went: the newest still take their part of a vector away.
    vector = np.ones(n)
    space.project(vector)
    assert np.count_nonzero(np.abs(vector) > 0.5) == 40
    assert np.abs(vector[-1]) < 1e-12


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("preconditioner", ["scaled", "two_level"])
def test_recycling_saves_iterations_and_changes_nothing_else(preconditioner: Preconditioner) -> None:
    problem = linear_step(wavelength=64.0)
    parts = split(problem.mesh, "metis", 9)
    random = np.random.default_rng(1)
    loads = [problem.b * (1 + 0.3 * random.standard_normal(len(problem.b))) for _ in range(3)]
    totals, errors = {}, {}
    for recycle in (False, True):
        with Decomposed(Team.world(), problem, parts, "consistent") as cut:
            step = cut.step(DualSettings(preconditioner, 1e-10, 3000, recycle=recycle))
            results = [cut.solve(step, b) for b in loads]
        totals[recycle] = sum(r.krylov_iterations for r in results)
        errors[recycle] = max(float(np.abs(a - b).max()) for a, b in zip(results[-1].dq, results[0].dq, strict=True))
    with Decomposed(Team.world(), problem, parts, "consistent") as cut:
        step = cut.step(DualSettings(preconditioner, 1e-10, 3000))
        for b in (*loads, problem.b):
            last = cut.solve(step, b)
        error = cut.relative_error(last.dq, one_domain_solution(problem, parts, "consistent"))
    assert totals[True] < totals[False]
    # 1e-10 of the right-hand side, times the interface operator's condition number (below 1e4 here).
    assert error <= 1e-6
    assert errors[True] == pytest.approx(errors[False], rel=1e-5)


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("preconditioner", ["scaled", "two_level"])
def test_the_estimated_error_is_near_the_true_one(preconditioner: Preconditioner) -> None:
    problem = linear_step(wavelength=64.0)
    parts = split(problem.mesh, "metis", 9)
    reference = one_domain_solution(problem, parts, "consistent")
    with Decomposed(Team.world(), problem, parts, "consistent") as cut:
        for target in (1e-2, 1e-4):
            step = cut.step(DualSettings(preconditioner, 1e-12, 3000))
            result = cut.solve(step, allowed=AllowedError(target))
            true = cut.rms_error(result.dq, reference)
            assert 0 < result.error <= 3 * target
            # P is spectrally near S_tot^-1: eigenvalues of P S_tot between 0.3 and 4 in the cases measured.
            assert result.error / 5 <= true <= 5 * result.error


@pytest.mark.parallel(RANKS)
def test_a_looser_error_takes_fewer_iterations_and_the_tolerance_is_the_floor() -> None:
    problem = linear_step(wavelength=64.0)
    parts = split(problem.mesh, "metis", 9)
    counts = []
    exactly = [AllowedError(rms) for rms in (0.0, 1e-5, 1e-2)]
    for allowed in (None, *exactly, AllowedError(0.0, 0.1), AllowedError(1e9)):
        with Decomposed(Team.world(), problem, parts, "consistent") as cut:
            counts.append(cut.solve(cut.step(DualSettings("scaled", 1e-8, 3000)), allowed=allowed).krylov_iterations)
    exact, floor, fine, coarse, share, nothing = counts
    assert exact == floor
    assert exact > fine > coarse > nothing == 0
    assert exact > share > 0


@pytest.mark.parallel(RANKS)
def test_the_error_of_a_solution_that_needs_no_iteration_is_what_it_was() -> None:
    problem = linear_step(wavelength=64.0)
    with Decomposed(Team.world(), problem, split(problem.mesh, "metis", 9), "consistent") as cut:
        step = cut.step(DualSettings("scaled", 1e-12, 3000, recycle=False))
        found, again = (cut.solve(step, allowed=AllowedError(1e-3)) for _ in range(2))
    assert found.krylov_iterations > again.krylov_iterations == 0
    assert again.error == pytest.approx(found.error, rel=1e-9)
