"""The start of the set-ups' motions, Eq. 22 of [BP17]."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.errors import InputError, is_collective
from ddic.kinematics.camera import MotionKind
from ddic.parallel.field import Field
from ddic.parallel.team import Team
from ddic.partition.split import find_cameras_at_nodes
from ddic.partition.subdomain import Interface, Subdomain
from ddic.start.frame_start import start_motions
from support.near_far_linear import NearFarCut, NearFarStep, near_far_step

RANKS = [1, 3]
MOTIONS = pytest.mark.parametrize("motion", ["translation", "rigid"])


def _own(cut: NearFarCut) -> list[Subdomain]:
    return [cut.problem.subdomains[k] for k in cut.numbers]


def _seen(cut: NearFarCut, field: NDArray[np.float64], alpha: list[NDArray[np.float64]]) -> Field:
    """What the camera of each subdomain sees of a field (n_nodes, 2) and motions, to first order."""
    setups = [camera.setup for camera in cut.problem.cameras]
    return Field(cut.team, _own(cut), [
        field[s.node_ids].ravel() + setups[s.camera].motion_columns(s.mesh.nodes) @ alpha[s.camera] for s in _own(cut)])


def _with_shared_nodes(problem: NearFarStep, subdomain: Subdomain, n_shared: int) -> Subdomain:
    """The same, with jumps to other cameras at the first few of their common nodes only."""
    at_nodes = find_cameras_at_nodes(problem.base.mesh, problem.labels, len(problem.cameras))
    common = np.flatnonzero(at_nodes.sum(axis=1) > 1)
    jumps = subdomain.jumps
    kept = ~np.isin(subdomain.numbers[jumps.unknowns] // 2, common[n_shared:])
    return replace(subdomain, jumps=Interface(jumps.unknowns[kept], jumps.multiplicity[kept], jumps.position[kept],
                                              jumps.first_row[kept], jumps.first_copy[kept]))


@pytest.mark.parallel(RANKS)
@MOTIONS
@pytest.mark.parametrize("layout", ["island", "edge", "two"])
def test_the_motion_between_fields_that_agree_is_found(layout: str, motion: MotionKind) -> None:
    problem = near_far_step(layout, "metis", 7, motion, regularized=False)
    cut = NearFarCut(Team.world(), problem)
    rng = np.random.default_rng(2)
    alpha = [rng.normal(size=c.setup.n_motion_unknowns) * 5 for c in problem.cameras]
    field = rng.normal(size=(problem.base.mesh.n_nodes, 2))
    found = start_motions(problem.cameras, _seen(cut, field, alpha))
    for a, b in zip(found, alpha, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)


@pytest.mark.parallel([1, 2])
def test_fields_that_disagree_leave_the_least_squares() -> None:
    problem = near_far_step("island", "blocks", 1, "translation", regularized=False)
    cut = NearFarCut(Team.world(), problem)
    u = [np.random.default_rng(s.index).normal(size=s.mesh.n_dofs) for s in problem.subdomains]
    found = start_motions(problem.cameras, Field(cut.team, _own(cut), [u[k] for k in cut.numbers]))
    far, near = problem.subdomains
    common = sorted(set(far.node_ids.tolist()) & set(near.node_ids.tolist()))
    jumps = [u[1].reshape(-1, 2)[near.node_ids.tolist().index(n)] - u[0].reshape(-1, 2)[far.node_ids.tolist().index(n)]
             for n in common]
    # The least squares of a translation are the mean jump from far to near.
    np.testing.assert_allclose(found[1], np.mean(jumps, axis=0), atol=1e-13)
    assert found[0].shape == (0,)


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize(("motion", "n_shared"), [("translation", 0), ("rigid", 1)])
def test_too_few_shared_nodes_are_refused(motion: MotionKind, n_shared: int) -> None:
    problem = near_far_step("island", "metis", 5, motion, regularized=False)
    cut = NearFarCut(Team.world(), problem)
    subdomains = [_with_shared_nodes(problem, s, n_shared) for s in _own(cut)]
    at_rest = Field(cut.team, subdomains, [np.zeros(s.n_field) for s in subdomains])
    with pytest.raises(InputError, match=r"too few nodes.*near.region") as caught:
        start_motions(problem.cameras, at_rest)
    assert is_collective(caught.value)


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize(("motion", "n_shared"), [("translation", 1), ("rigid", 2)])
def test_as_few_shared_nodes_as_can_tell_are_enough(motion: MotionKind, n_shared: int) -> None:
    # Guards the test above.
    problem = near_far_step("island", "metis", 5, motion, regularized=False)
    cut = NearFarCut(Team.world(), problem)
    subdomains = [_with_shared_nodes(problem, s, n_shared) for s in _own(cut)]
    found = start_motions(problem.cameras, Field(cut.team, subdomains, [np.zeros(s.n_field) for s in subdomains]))
    np.testing.assert_array_equal(found[1], np.zeros(problem.cameras[1].setup.n_motion_unknowns))
