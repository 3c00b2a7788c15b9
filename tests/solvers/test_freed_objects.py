"""Nothing of PETSc is left behind: not by use over and over, and not by an error on the way."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse

from ddic.errors import ConvergenceError, SingularSubdomainError
from ddic.parallel.team import Team
from ddic.solvers.dual.dual_step import DualSettings, DualStep
from ddic.solvers.dual.preconditioner import LocalInverseKind, Preconditioner, SparseInverse
from ddic.solvers.exchange import average_copies
from ddic.solvers.linear_step import AllowedError
from ddic.solvers.local_system import LocalOperator
from ddic.solvers.whole_system import AssembledStep, ConjugateGradientStep
from support.linear import Decomposed, StepProblem, linear_step, split
from support.petsc_objects import count_live_objects
from support.textureless import corner, without_texture

RANKS = [1, 3]


def _cut(problem: StepProblem) -> Decomposed:
    return Decomposed(Team.world(), problem, split(problem.mesh, "metis", 9), "consistent")


def _count_growth(folder: Path, work: Callable[[], None]) -> dict[str, int]:
    """Objects that three more uses leave behind, by class."""
    team = Team.world()
    count_live_objects(team, folder)
    # The first use makes what PETSc keeps for good.
    work()
    before = count_live_objects(team, folder)
    for _ in range(3):
        work()
    after = count_live_objects(team, folder)
    return {name: n - before.get(name, 0) for name, n in after.items() if n != before.get(name, 0)}


def _solve_twice(cut: Decomposed, step: DualStep | AssembledStep | ConjugateGradientStep) -> None:
    for allowed in (AllowedError(1e-2), None):
        result = cut.solve(step, allowed=allowed)
    average_copies(result.dq)


@pytest.mark.parallel(RANKS)
def test_the_count_sees_what_is_left_behind(shared_path: Path) -> None:
    problem = linear_step(8)
    left_behind = []

    def leave() -> None:
        with _cut(problem) as cut:
            left_behind.append(ConjugateGradientStep(cut.team, cut.systems, 1e-6, 100))

    growth = _count_growth(shared_path, leave)
    for step in left_behind:
        step.destroy()
    assert growth["Vector"] >= 3
    assert growth["Krylov Solver"] == 3


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize(("preconditioner", "local_inverse"), [
    ("none", "dense"), ("scaled", "dense"), ("two_level", "sparse")])
def test_dual_steps_leave_nothing(preconditioner: Preconditioner, local_inverse: LocalInverseKind,
                                  shared_path: Path) -> None:
    problem = linear_step(8, 32.0)
    settings = DualSettings(preconditioner, 1e-6, 500, local_inverse=local_inverse)

    def use() -> None:
        with _cut(problem) as cut:
            _solve_twice(cut, cut.step(settings))

    assert _count_growth(shared_path, use) == {}


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("kind", ["assembled", "conjugate_gradient"])
def test_steps_of_the_whole_region_leave_nothing(kind: str, shared_path: Path) -> None:
    problem = linear_step(8, 32.0)

    def use() -> None:
        with _cut(problem) as cut:
            step: AssembledStep | ConjugateGradientStep
            if kind == "assembled":
                step = AssembledStep(cut.team, cut.systems, 0.0)
            else:
                step = ConjugateGradientStep(cut.team, cut.systems, 1e-6, 500)
            _solve_twice(cut, step)
            step.destroy()

    assert _count_growth(shared_path, use) == {}


@pytest.mark.parallel(RANKS)
def test_constructors_that_fail_leave_nothing(shared_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = linear_step(wavelength=32.0)
    healthy = SparseInverse._check_inertia
    if Team.world().rank == Team.world().size - 1:
        monkeypatch.setattr(SparseInverse, "_check_inertia", lambda self, n: healthy(self, n + 1))

    def fail() -> None:
        with _cut(problem) as cut:
            systems = without_texture(cut, corner)
            with pytest.raises(SingularSubdomainError):
                AssembledStep(cut.team, systems, 1e-9 * problem.mean_diagonal)
            with pytest.raises(SingularSubdomainError):
                cut.step(DualSettings("two_level", local_inverse="sparse"))
        with _cut(linear_step()) as cut, pytest.raises(SingularSubdomainError):
            ConjugateGradientStep(cut.team, without_texture(cut, corner), 1e-6, 100)

    assert _count_growth(shared_path, fail) == {}


@pytest.mark.parallel(RANKS)
def test_solutions_that_fail_leave_nothing(shared_path: Path) -> None:
    problem = linear_step(8, 32.0)

    def fail() -> None:
        with _cut(problem) as cut:
            step = ConjugateGradientStep(cut.team, cut.systems, 1e-12, 2)
            for failing in (step, cut.step(DualSettings("scaled", 1e-12, 2))):
                with pytest.raises(ConvergenceError):
                    cut.solve(failing)
            step.destroy()

    assert _count_growth(shared_path, fail) == {}


def test_a_singular_local_operator_leaves_nothing(shared_path: Path) -> None:
    nearly_singular = sparse.diags(np.r_[1e-12, np.ones(9)]).tocsr()
    kept = []

    def fail() -> None:
        with pytest.raises(SingularSubdomainError) as caught:
            LocalOperator(nearly_singular, smallest_eigenvalue=1e-9, where="here")
        # The traceback holds what the constructor had made.
        kept.append(caught.value)

    assert _count_growth(shared_path, fail) == {}
