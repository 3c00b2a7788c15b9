"""Conjugate gradients on the whole mesh against the monolithic step, on any number of ranks."""

from __future__ import annotations

import numpy as np
import pytest
from petsc4py import PETSc

from ddic.errors import ConvergenceError, SingularSubdomainError, is_collective
from ddic.parallel.team import Team
from ddic.partition.subdomain import Weighting
from ddic.solvers.linear_step import AllowedError
from ddic.solvers.whole_system import OF_ALLOWED, AssembledStep, ConjugateGradientStep
from support.linear import Decomposed, linear_step, one_domain_solution, split
from support.textureless import corner, without_texture

RANKS = [1, 2, 3, 4]
WAVELENGTH = 32.0
# The tolerance is one on the relative error of dq, here of its largest entry.
TIGHT, SAME = 1e-10, 1e-9


def _step(cut: Decomposed, tolerance: float = TIGHT, most: int = 2000) -> ConjugateGradientStep:
    return ConjugateGradientStep(cut.team, cut.systems, tolerance, most)


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("wavelength", [None, WAVELENGTH])
@pytest.mark.parametrize(("kind", "n_subdomains"), [("blocks", 4), ("blocks", 9), ("metis", 16)])
@pytest.mark.parametrize("weighting", ["consistent", "paper"])
def test_equals_monolithic(weighting: Weighting, kind: str, n_subdomains: int, wavelength: float | None) -> None:
    problem = linear_step(wavelength=wavelength)
    parts = split(problem.mesh, kind, n_subdomains)
    reference = one_domain_solution(problem, parts, weighting)
    with Decomposed(Team.world(), problem, parts, weighting) as cut:
        step = _step(cut)
        result = cut.solve(step)
        step.destroy()
        error = cut.relative_error(result.dq, reference)
    assert error <= SAME
    assert 0 < result.krylov_iterations == len(result.krylov_history) - 1
    assert result.krylov_history[-1] <= TIGHT


@pytest.mark.parallel(RANKS)
def test_the_product_is_that_of_the_assembled_operator() -> None:
    problem = linear_step(wavelength=WAVELENGTH)
    with Decomposed(Team.world(), problem, split(problem.mesh, "blocks", 9), "consistent") as cut:
        assembled, step = AssembledStep(cut.team, cut.systems, 0.0), _step(cut)
        x = step._left.duplicate()
        x.setArray(np.random.default_rng(cut.team.rank).normal(size=x.getLocalSize()))
        expected, found = x.duplicate(), x.duplicate()
        assembled._matrix.mult(x, expected)
        step._matrix.mult(x, found)
        found.axpy(-1.0, expected)
        difference, size = found.norm(), expected.norm()
        for thing in (x, expected, found, assembled, step):
            thing.destroy()
    assert difference <= 1e-12 * size  # other sums of the same products


@pytest.mark.parallel(RANKS)
def test_the_estimate_of_the_error_is_near_it() -> None:
    problem = linear_step(wavelength=WAVELENGTH)
    parts = split(problem.mesh, "metis", 9)
    reference = one_domain_solution(problem, parts, "consistent")
    ratios, iterations = [], []
    with Decomposed(Team.world(), problem, parts, "consistent") as cut:
        for allowed in (1e-1, 1e-3, 1e-5):
            step = _step(cut)
            result = cut.solve(step, allowed=AllowedError(allowed))
            step.destroy()
            assert result.error <= OF_ALLOWED * allowed
            ratios.append(cut.rms_error(result.dq, reference) / result.error)
            iterations.append(result.krylov_iterations)
    # The lowest eigenvalue bounds the error from above, which is mostly in other modes: a third to a hundredth of it.
    # At the first look the eigenvalue is not yet found: not more than twice the estimate.
    assert max(ratios) <= 2.0
    assert min(ratios) >= 1e-2
    assert iterations == sorted(set(iterations))


@pytest.mark.parallel(RANKS)
def test_a_step_is_taken_up_where_it_was_left() -> None:
    problem = linear_step(wavelength=WAVELENGTH)
    parts = split(problem.mesh, "blocks", 9)
    reference = one_domain_solution(problem, parts, "consistent")
    with Decomposed(Team.world(), problem, parts, "consistent") as cut:
        step = _step(cut)
        whole = cut.solve(step).krylov_iterations
        again = cut.solve(step)
        step.destroy()
        step = _step(cut)
        first = cut.solve(step, allowed=AllowedError(1e-3))
        second = cut.solve(step)
        step.destroy()
        error = cut.relative_error(second.dq, reference)
    assert again.krylov_iterations == 0
    assert error <= SAME
    # What the directions of the first part knew is lost, its reduction is not.
    assert second.krylov_history[0] <= 1.1 * first.krylov_history[-1]
    assert second.krylov_iterations < whole


@pytest.mark.parallel([1, 2])
def test_a_step_that_forgets_comes_to_the_same_bits() -> None:
    problem = linear_step(wavelength=WAVELENGTH)
    with Decomposed(Team.world(), problem, split(problem.mesh, "blocks", 4), "consistent") as cut:
        fresh, used = _step(cut), _step(cut)
        expected = cut.solve(fresh).dq
        cut.solve(used, allowed=AllowedError(1e-3))
        # Guards the test: a solution that is taken up again leaves other digits.
        taken_up = cut.solve(used).dq
        used.forget()
        again = cut.solve(used).dq
        for step in (fresh, used):
            step.destroy()
        assert cut.team.sum(sum(not np.array_equal(a, b) for a, b in zip(taken_up, expected, strict=True))) > 0
        for one, two in zip(again, expected, strict=True):
            np.testing.assert_array_equal(one, two)


@pytest.mark.parallel([1, 2])
def test_failures_say_what_to_do() -> None:
    problem = linear_step(wavelength=WAVELENGTH)
    with Decomposed(Team.world(), problem, split(problem.mesh, "blocks", 4), "consistent") as cut:
        step = _step(cut, most=5)
        with pytest.raises(ConvergenceError, match=r"5 iterations.*solver\.method = \"dual\"") as failed:
            cut.solve(step)
        step.destroy()
    assert is_collective(failed.value)
    problem = linear_step()
    with (Decomposed(Team.world(), problem, split(problem.mesh, "blocks", 4), "consistent") as cut,
          pytest.raises(SingularSubdomainError, match=r"column 1\d\d, row 1\d\d.*too little") as held):
        ConjugateGradientStep(cut.team, without_texture(cut, corner), TIGHT, 100)
    assert is_collective(held.value)


@pytest.mark.parallel([1, 2])
def test_options_come_last() -> None:
    problem = linear_step(wavelength=WAVELENGTH)
    options = PETSc.Options()
    options.setValue("cg_ksp_type", "minres")
    try:
        with Decomposed(Team.world(), problem, split(problem.mesh, "blocks", 4), "consistent") as cut:
            step = _step(cut)
            kind = step._ksp.getType()
            step.destroy()
    finally:
        options.delValue("cg_ksp_type")
    assert kind == "minres"
