"""The dual step against the monolithic one, on any number of ranks."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from ddic.errors import ConvergenceError, is_collective
from ddic.parallel.team import Team
from ddic.partition.subdomain import Weighting
from ddic.solvers.dual.dual_step import DualSettings
from ddic.solvers.dual.preconditioner import Preconditioner
from support.linear import Decomposed, linear_step, one_domain_solution, split
from support.sharers import count_sharers_of_nodes

RANKS = [1, 2, 3, 4]
TIGHT = 1e-12
# The Krylov residual is 1e-12 of the right-hand side and the interface operators' condition numbers stay
# below 1e3 at these cut-off wavelengths: 1e-9 leaves no room for anything but rounding.
SAME = 1e-9
WAVELENGTH = 32.0

PARTITIONS = [("blocks", 4), ("blocks", 9), ("blocks", 16), ("metis", 4), ("metis", 9), ("metis", 16)]
ONE_LEVEL: list[Preconditioner] = ["none", "paper", "scaled"]
PRECONDITIONERS: list[Preconditioner] = [*ONE_LEVEL, "two_level"]


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize(("kind", "n_subdomains"), PARTITIONS)
@pytest.mark.parametrize("weighting", ["consistent", "paper"])
def test_dual_equals_monolithic(weighting: Weighting, kind: str, n_subdomains: int) -> None:
    problem = linear_step(wavelength=WAVELENGTH)
    parts = split(problem.mesh, kind, n_subdomains)
    reference = one_domain_solution(problem, parts, weighting)
    with Decomposed(Team.world(), problem, parts, weighting) as cut:
        results = {p: cut.solve(cut.step(DualSettings(p, TIGHT, 3000))) for p in PRECONDITIONERS}
        errors = {p: cut.relative_error(result.dq, reference) for p, result in results.items()}
    assert max(errors.values()) <= SAME, errors
    assert min(result.krylov_iterations for result in results.values()) > 0
    assert max(result.krylov_history[-1] for result in results.values()) <= TIGHT


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize(("kind", "n_subdomains"), PARTITIONS)
def test_dual_without_regularization_equals_monolithic(kind: str, n_subdomains: int) -> None:
    problem = linear_step()
    parts = split(problem.mesh, kind, n_subdomains)
    reference = one_domain_solution(problem, parts, "consistent")
    with Decomposed(Team.world(), problem, parts, "consistent") as cut:
        steps = {p: cut.step(DualSettings(p, TIGHT, 3000)) for p in PRECONDITIONERS}
        errors = {p: cut.relative_error(cut.solve(step).dq, reference) for p, step in steps.items()}
        m = count_sharers_of_nodes(problem.mesh, parts)
    assert max(errors.values()) <= SAME, errors
    # Lambda alone: m - 1 rows for each of the two components of a node with m copies, no LambdaBar.
    assert {step.n_interface for step in steps.values()} == {2 * int((m - 1).sum())}


@pytest.mark.parallel(RANKS)
def test_the_two_weightings_differ() -> None:
    # Guards the tests above: both oracles would agree if the weights were not used at all.
    problem = linear_step(wavelength=WAVELENGTH)
    parts = split(problem.mesh, "blocks", 16)
    consistent = one_domain_solution(problem, parts, "consistent")
    paper = one_domain_solution(problem, parts, "paper")
    assert np.abs(consistent - paper).max() > 1e-4 * np.abs(consistent).max()


@pytest.mark.parallel(1)
@pytest.mark.parametrize("wavelength", [None, WAVELENGTH])
def test_one_subdomain_needs_no_interface(wavelength: float | None) -> None:
    problem = linear_step(wavelength=wavelength)
    parts = np.zeros(problem.mesh.n_cells, dtype=np.int64)
    with Decomposed(Team.world(), problem, parts, "consistent") as cut:
        step = cut.step(DualSettings())
        result = cut.solve(step)
        error = cut.relative_error(result.dq, one_domain_solution(problem, parts, "consistent"))
    assert step.n_interface == 0
    assert result.krylov_iterations == 0
    assert error <= 1e-13  # the same factorisation of the same matrix


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("preconditioner", PRECONDITIONERS)
def test_warm_start_with_the_same_data_takes_no_iteration(preconditioner: Preconditioner) -> None:
    problem = linear_step(wavelength=WAVELENGTH)
    with Decomposed(Team.world(), problem, split(problem.mesh, "blocks", 9), "consistent") as cut:
        step = cut.step(DualSettings(preconditioner, 1e-8, 3000))
        first = cut.solve(step)
        second = cut.solve(step)
    assert first.krylov_iterations > 0
    assert second.krylov_iterations == 0
    # Same multipliers, same arithmetic but for the order of sums over ranks.
    assert max(np.abs(a - b).max() for a, b in zip(first.dq, second.dq, strict=True)) <= 1e-12


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("preconditioner", ONE_LEVEL)
def test_stop_is_relative_to_the_right_hand_side_when_warm_started(preconditioner: Preconditioner) -> None:
    problem = linear_step(wavelength=WAVELENGTH)
    tolerance = 1e-6
    with Decomposed(Team.world(), problem, split(problem.mesh, "blocks", 9), "consistent") as cut:
        step = cut.step(DualSettings(preconditioner, tolerance, 3000))
        first = cut.solve(step)
        changed = cut.solve(step, problem.b * 1.001)
    # From zero the first residual is the right-hand side itself (a coarse space would lower it before) ...
    assert first.krylov_history[0] == pytest.approx(1.0, rel=1e-10)
    # ... while a warm start begins where the data have changed, a thousandth of it: relative to its own
    # first residual the solve would go on to 1e-9.
    assert 1e-4 <= changed.krylov_history[0] <= 1e-2
    assert tolerance * 1e-2 < changed.krylov_history[-1] <= tolerance
    assert 0 < changed.krylov_iterations < first.krylov_iterations


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("preconditioner", PRECONDITIONERS)
def test_history_holds_the_true_residual_not_the_preconditioned_one(preconditioner: Preconditioner) -> None:
    problem = linear_step(wavelength=WAVELENGTH)
    tolerance = 1e-5
    with Decomposed(Team.world(), problem, split(problem.mesh, "metis", 9), "consistent") as cut:
        step = cut.step(DualSettings(preconditioner, tolerance, 3000))
        result = cut.solve(step)
        # With the same data, what a solve finds before its first iteration is |t_tot - S v| / |t_tot|.
        again = cut.solve(step)
    assert len(result.krylov_history) == result.krylov_iterations + 1
    # GMRES's recurrence agrees with the recomputed residual to rounding over |t_tot|.
    assert again.krylov_history[0] == pytest.approx(result.krylov_history[-1], abs=1e-12)


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("preconditioner", ONE_LEVEL)
def test_unit_of_the_stiffness_changes_nothing(preconditioner: Preconditioner) -> None:
    problem = linear_step(wavelength=WAVELENGTH)
    unit = 1e5
    other = dataclasses.replace(problem, eta=problem.eta * unit**2, stiffness_scale=1 / unit)
    parts = split(problem.mesh, "blocks", 9)
    results = []
    for data in (problem, other):
        with Decomposed(Team.world(), data, parts, "consistent") as cut:
            results.append(cut.solve(cut.step(DualSettings(preconditioner, 1e-6, 3000))))
            error = cut.relative_error(results[-1].dq, one_domain_solution(problem, parts, "consistent"))
            assert error <= 1e-3
    # Exact arithmetic gives the same iterates; one iteration of slack for rounding at the threshold.
    assert abs(results[0].krylov_iterations - results[1].krylov_iterations) <= 1
    n = min(len(r.krylov_history) for r in results)
    np.testing.assert_allclose(results[0].krylov_history[:n], results[1].krylov_history[:n], rtol=1e-6)


@pytest.mark.parallel(RANKS)
def test_too_few_iterations_raise_on_all_ranks() -> None:
    problem = linear_step(wavelength=WAVELENGTH)
    with Decomposed(Team.world(), problem, split(problem.mesh, "blocks", 9), "consistent") as cut:
        step = cut.step(DualSettings("none", 1e-12, 2))
        with pytest.raises(ConvergenceError, match=r"in 2 Krylov iterations.*max_iterations") as caught:
            cut.solve(step)
    assert is_collective(caught.value)


@pytest.mark.parallel(RANKS)
def test_a_right_hand_side_that_is_not_finite_raises() -> None:
    problem = linear_step(wavelength=WAVELENGTH)
    b = problem.b.copy()
    b[0] = np.nan
    with Decomposed(Team.world(), problem, split(problem.mesh, "blocks", 9), "consistent") as cut:
        step = cut.step(DualSettings())
        with pytest.raises(ConvergenceError, match="interface problem"):
            cut.solve(step, b)


@pytest.mark.parallel(RANKS)
def test_preconditioners_need_fewer_iterations() -> None:
    problem = linear_step(wavelength=64.0)
    parts = split(problem.mesh, "blocks", 16)
    iterations = {}
    with Decomposed(Team.world(), problem, parts, "consistent") as cut:
        for preconditioner in PRECONDITIONERS:
            step = cut.step(DualSettings(preconditioner, 1e-6, 3000))
            iterations[preconditioner] = cut.solve(step).krylov_iterations
    # Measured (docs/solver.md): scaled beats paper; either beats none by a wide margin.
    assert iterations["scaled"] < iterations["paper"] < iterations["none"]
    assert 3 * iterations["scaled"] <= iterations["none"]
