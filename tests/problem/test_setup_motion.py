"""The start of the set-ups' motions, Eq. 22 of [BP17], and their covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from ddic.kinematics.pose import Motion
from ddic.problem.setup_motion import covariance, setup_motions, start_of_motion
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.errors import InputError, is_on_all_ranks
from ddic.partition.by_camera import cameras_at_nodes
from ddic.solvers.gauss_newton import OwnedPart
from support.near_far_linear import NearFarCut, NearFarStep, dense_operators, near_far_step

RANKS = [1, 2, 4]
MOTIONS = pytest.mark.parametrize("motion", ["translation", "rigid"])


def _shared(problem: NearFarStep) -> NDArray[np.int64]:
    present = cameras_at_nodes(problem.base.mesh, problem.labels, len(problem.cameras))
    return np.flatnonzero(present.sum(axis=1) > 1)


def _seen(problem: NearFarStep, parts: list[OwnedPart], field: NDArray[np.float64],
          alpha: list[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
    """What each part sees of a field (n_nodes, 2) and motions, to first order."""
    return [field[p.subdomain.node_ids].ravel()
            + problem.cameras[p.subdomain.camera].rig.rigid_columns(p.subdomain.mesh.nodes)
            @ alpha[p.subdomain.camera] for p in parts]


@pytest.mark.parallel(RANKS)
@MOTIONS
@pytest.mark.parametrize("layout", ["island", "edge", "two"])
def test_the_motion_between_fields_that_agree_is_found(layout: str, motion: Motion) -> None:
    problem = near_far_step(layout, "metis", 7, motion, regularized=False)
    cut = NearFarCut(MPI.COMM_WORLD, problem)
    rng = np.random.default_rng(2)
    alpha = [rng.normal(size=c.rig.n_shifts) * 5 for c in problem.cameras]
    field = rng.normal(size=(problem.base.mesh.n_nodes, 2))
    found = start_of_motion(cut.team, problem.cameras, cut.parts, _seen(problem, cut.parts, field, alpha),
                            _shared(problem))
    for a, b in zip(found, alpha, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)


@pytest.mark.parallel([1, 2])
def test_fields_that_disagree_leave_the_least_squares() -> None:
    problem = near_far_step("island", "blocks", 1, "translation", regularized=False)
    cut = NearFarCut(MPI.COMM_WORLD, problem)
    u = [np.random.default_rng(s.index).normal(size=s.mesh.n_dofs) for s in problem.subdomains]
    found = start_of_motion(cut.team, problem.cameras, cut.parts, [u[k] for k in cut.numbers], _shared(problem))
    far, near = problem.subdomains
    common = sorted(set(far.node_ids.tolist()) & set(near.node_ids.tolist()))
    jumps = [u[1].reshape(-1, 2)[near.node_ids.tolist().index(n)] - u[0].reshape(-1, 2)[far.node_ids.tolist().index(n)]
             for n in common]
    # The least squares of a translation are the mean jump from far to near.
    np.testing.assert_allclose(found[1], np.mean(jumps, axis=0), atol=1e-13)
    assert found[0].shape == (0,)


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize(("motion", "n_shared"), [("translation", 0), ("rigid", 1)])
def test_too_few_shared_nodes_are_refused(motion: Motion, n_shared: int) -> None:
    problem = near_far_step("island", "metis", 5, motion, regularized=False)
    cut = NearFarCut(MPI.COMM_WORLD, problem)
    u = [np.zeros(p.n_dofs) for p in cut.parts]
    with pytest.raises(InputError, match=r"too few nodes.*near.region") as caught:
        start_of_motion(cut.team, problem.cameras, cut.parts, u, _shared(problem)[:n_shared])
    assert is_on_all_ranks(caught.value)


def _check_covariance(problem: NearFarStep, method: str) -> None:
    sigma = 1.7
    cut = NearFarCut(MPI.COMM_WORLD, problem, method=method, tolerance=1e-10, max_iterations=3000)
    with cut.step() as step:
        found = covariance(cut.team, cut.parts, cut.assembly.systems, step, sigma)
    operator, texture = dense_operators(problem)
    inverse = np.linalg.inv(operator)
    whole = 2 * sigma**2 * inverse @ texture @ inverse
    first = problem.base.mesh.n_dofs
    assert sorted(found) == [1, 2]
    for camera in (1, 2):
        n = problem.cameras[camera].rig.n_shifts
        expected = whole[first: first + n, first: first + n]
        # Solutions to 1e-10 of dq, and A's condition number of 1e6 with a motion in it, before rounding.
        np.testing.assert_allclose(found[camera], expected, atol=1e-7 * np.abs(expected).max())
        first += n


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize(("motion", "use_far"), [("translation", False), ("rigid", True)],
                         ids=["near alone", "far as well"])
def test_covariance_is_that_of_the_whole_system(motion: Motion, use_far: bool) -> None:
    _check_covariance(near_far_step("two", "metis", 4, motion, regularized=True, use_far=use_far), "dual")


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("method", ["assembled", "conjugate_gradient"])
def test_covariance_by_other_methods(method: str) -> None:
    _check_covariance(near_far_step("two", "metis", 4, "rigid", regularized=True), method)


def test_motions_are_told_in_pixels_and_radians() -> None:
    problem = near_far_step("island", "blocks", 1, "rigid", regularized=False)
    rig = problem.cameras[1].rig
    spread = np.diag([1.0, 4.0, 9.0])
    (told,) = setup_motions(problem.cameras, [np.zeros(0), np.array([3.7, -2.2, 0.5])], {1: spread})
    assert (told.camera, told.alpha.tolist()) == (1, [3.7, -2.2])
    assert told.theta == pytest.approx(0.5 / rig.length, rel=1e-15)
    assert told.rig is rig
    np.testing.assert_allclose(np.sqrt(np.diag(told.covariance)), [1.0, 2.0, 3.0 / rig.length], rtol=1e-15)
    plain = replace(problem.cameras[1], rig=replace(rig, motion="translation"))
    (told,) = setup_motions([problem.cameras[0], plain], [np.zeros(0), np.array([3.7, -2.2])], {1: spread[:2, :2]})
    assert (told.theta, told.covariance.shape) == (0.0, (2, 2))
