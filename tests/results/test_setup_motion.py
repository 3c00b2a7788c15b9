"""The covariance of the set-ups' motions, and their units."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ddic.kinematics.camera import MotionKind
from ddic.parallel.team import Team
from ddic.results.near import collect_motions, describe_motions, estimate_covariances
from support.near_far_linear import NearFarCut, NearFarStep, dense_operators, near_far_step

RANKS = [1, 3]


def _check_covariance(problem: NearFarStep, method: str) -> None:
    sigma = 1.7
    cut = NearFarCut(Team.world(), problem, method=method, tolerance=1e-10, max_iterations=3000)
    with cut.step() as step:
        found = estimate_covariances(cut.team, cut.assembly.systems, step, sigma)
    operator, texture = dense_operators(problem)
    inverse = np.linalg.inv(operator)
    whole = 2 * sigma**2 * inverse @ texture @ inverse
    first = problem.base.mesh.n_dofs
    assert sorted(found) == [1, 2]
    for camera in (1, 2):
        n = problem.cameras[camera].setup.n_motion_unknowns
        expected = whole[first: first + n, first: first + n]
        # Solutions to 1e-10 of dq, and A's condition number of 1e6 with a motion in it, before rounding.
        np.testing.assert_allclose(found[camera], expected, atol=1e-7 * np.abs(expected).max())
        first += n


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize(("motion", "use_far"), [("translation", False), ("rigid", True)],
                         ids=["near alone", "far as well"])
def test_covariance_is_that_of_the_whole_system(motion: MotionKind, use_far: bool) -> None:
    _check_covariance(near_far_step("two", "metis", 4, motion, regularized=True, use_far=use_far), "dual")


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("method", ["assembled", "conjugate_gradient"])
def test_covariance_by_other_methods(method: str) -> None:
    _check_covariance(near_far_step("two", "metis", 4, "rigid", regularized=True), method)


def test_motions_are_told_in_pixels_and_radians() -> None:
    problem = near_far_step("island", "blocks", 1, "rigid", regularized=False)
    setup = problem.cameras[1].setup
    spread = np.diag([1.0, 4.0, 9.0])
    (told,) = describe_motions(problem.cameras, [np.zeros(0), np.array([3.7, -2.2, 0.5])], {1: spread})
    assert (told.camera, told.alpha.tolist()) == (1, [3.7, -2.2])
    assert told.theta == pytest.approx(0.5 / setup.length, rel=1e-15)
    assert told.setup is setup
    np.testing.assert_allclose(np.sqrt(np.diag(told.covariance)), [1.0, 2.0, 3.0 / setup.length], rtol=1e-15)
    plain = replace(problem.cameras[1], setup=replace(setup, motion="translation"))
    (told,) = describe_motions([problem.cameras[0], plain], [np.zeros(0), np.array([3.7, -2.2])], {1: spread[:2, :2]})
    assert (told.theta, told.covariance.shape) == (0.0, (2, 2))


@pytest.mark.parallel(RANKS)
def test_every_rank_knows_every_motion() -> None:
    problem = near_far_step("two", "metis", 7, "rigid", regularized=False)
    cut = NearFarCut(Team.world(), problem)
    own = [problem.subdomains[k] for k in cut.numbers]
    found = collect_motions(cut.team, problem.cameras, own, [problem.q[k] for k in cut.numbers])
    expected = {s.camera: q[s.n_field:] for s, q in zip(problem.subdomains, problem.q, strict=True)}
    assert [len(motion) for motion in found] == [0, 3, 3]
    for camera, motion in enumerate(found):
        np.testing.assert_array_equal(motion, expected[camera])
