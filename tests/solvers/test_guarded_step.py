"""A step that another one takes the place of."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.errors import ConvergenceError, as_collective
from ddic.solvers.linear_step import GuardedStep, StepResult
from support.fields import plain_field


class Answer:
    """A step that gives a number, or fails."""

    def __init__(self, number: float, error: Exception | None = None) -> None:
        self.number, self.error = number, error
        self.n_solved = self.n_destroyed = 0

    def solve(self, q: object, b: object, allowed: object = None) -> StepResult:
        self.n_solved += 1
        if self.error is not None:
            raise self.error
        return StepResult(plain_field(np.array([self.number])))

    def destroy(self) -> None:
        self.n_destroyed += 1


NOTHING = plain_field()
FAILURE = as_collective(ConvergenceError("too many iterations"))


def test_the_other_step_stays_and_the_first_is_freed_before_it_is_built() -> None:
    first, other, freed = Answer(1.0, FAILURE), Answer(2.0), []

    def build(error: ConvergenceError) -> Answer:
        assert error is FAILURE
        freed.append(first.n_destroyed)
        return other

    step = GuardedStep(first, build)
    assert [step.solve(NOTHING, NOTHING).dq[0][0] for _ in range(2)] == [2.0, 2.0]
    assert (freed, first.n_solved, other.n_solved) == ([1], 1, 2)
    step.destroy()
    assert (first.n_destroyed, other.n_destroyed) == (1, 1)


def test_a_step_that_converges_is_left_alone() -> None:
    first = Answer(1.0)
    step = GuardedStep(first, lambda error: pytest.fail("there is no reason"))
    assert step.solve(NOTHING, NOTHING).dq[0][0] == 1.0


def test_what_one_rank_alone_raises_is_not_answered_by_a_collective_step() -> None:
    step = GuardedStep(Answer(1.0, ConvergenceError("here alone")), lambda error: pytest.fail("others would wait"))
    with pytest.raises(ConvergenceError, match="here alone"):
        step.solve(NOTHING, NOTHING)


def test_the_other_step_may_fail_too() -> None:
    step = GuardedStep(Answer(1.0, FAILURE), lambda error: Answer(2.0, FAILURE))
    for _ in range(2):
        with pytest.raises(ConvergenceError):
            step.solve(NOTHING, NOTHING)
