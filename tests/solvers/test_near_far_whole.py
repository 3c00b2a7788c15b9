"""The steps on the whole mesh with near and far cameras against the saddle point of Eq. 21 of [BP17] with one gap."""

from __future__ import annotations

import pytest

from ddic.kinematics.camera import MotionKind
from ddic.parallel.team import Team
from support.near_far_linear import NearFarCut, near_far_step, saddle_point_solution

RANKS = [1, 2, 4]
# Two factorisations of one system, whose condition number is about 1e4.
SAME = {"assembled": 1e-10, "conjugate_gradient": 1e-9}
# The tolerance of conjugate gradients is one on the relative error of dq.
TIGHT = 1e-10


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("method", SAME)
@pytest.mark.parametrize("regularized", [False, True], ids=["plain", "regularized"])
@pytest.mark.parametrize(("layout", "n", "motion", "use_far"), [
    ("island", 9, "rigid", False), ("edge", 5, "translation", False), ("two", 5, "rigid", True)])
def test_equals_the_saddle_point(layout: str, n: int, motion: MotionKind, use_far: bool, regularized: bool,
                                 method: str) -> None:
    problem = near_far_step(layout, "metis", n, motion, regularized=regularized, use_far=use_far)
    reference = saddle_point_solution(problem)
    cut = NearFarCut(Team.world(), problem, method=method, tolerance=TIGHT, max_iterations=2000)
    with cut.step() as step:
        dq = cut.solve(step).dq
    assert cut.relative_error(dq, reference) <= SAME[method]
    # Motions are tenths where displacements are tens of pixels, and held at the interface only.
    assert cut.motion_error(dq, reference) <= 100 * SAME[method]


@pytest.mark.parallel([1, 4])
@pytest.mark.parametrize("method", SAME)
def test_the_papers_weighting(method: str) -> None:
    problem = near_far_step("island", "metis", 9, "rigid", regularized=True)
    cut = NearFarCut(Team.world(), problem, method=method, weighting="paper", tolerance=TIGHT, max_iterations=2000)
    with cut.step() as step:
        dq = cut.solve(step).dq
    assert cut.relative_error(dq, saddle_point_solution(problem, paper_weighting=True)) <= SAME[method]
