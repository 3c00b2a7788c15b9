"""The size of a correction does not depend on where the specimen is, how it is turned, or who owns its parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.kinematics.nodal import NodalRegion
from ddic.mesh.mesh import Mesh
from ddic.parallel.distribution import split_evenly
from ddic.parallel.field import Field
from ddic.parallel.team import Team
from ddic.partition.sharing import build_subdomains
from ddic.partition.subdomain import Subdomain
from ddic.solvers import correction_size
from ddic.solvers.correction_size import (
    KNOWN_PX,
    CorrectionSize,
    Tolerances,
    measure_correction,
    weigh_nodes,
)
from support.pictures import square_mesh

MESH = square_mesh(1000.0, 1144.0)
RNG = np.random.default_rng(5)
FIELD, CHANGE = RNG.normal(size=(2, MESH.n_nodes, 2))
CHANGE *= 1e-3
AFFINE = np.array([150.0, -120.0]) + MESH.nodes @ np.array([[0.05, 0.3], [-0.25, -0.02]])


def split(mesh: Mesh, n_subdomains: int) -> list[Subdomain]:
    parts = np.arange(mesh.n_cells) % n_subdomains
    return build_subdomains(NodalRegion(mesh), parts, np.zeros(mesh.n_dofs, dtype=bool))


def measure(team: Team, subdomains: list[Subdomain], change: NDArray[np.float64], field: NDArray[np.float64],
            deviations: NDArray[np.float64] | None = None, largest: float = np.inf) -> CorrectionSize:
    own = split_evenly(np.ones(len(subdomains)), team.size)[team.rank]
    mine = [subdomains[k] for k in own]
    weights = None if deviations is None else weigh_nodes([deviations[s.node_ids] for s in mine])
    dq = Field(team, mine, [change[s.node_ids].ravel() for s in mine])
    q = dq.with_parts((field - change)[s.node_ids].ravel() for s in mine)
    return measure_correction(dq, q, weights, largest)


def without_affine_part(field: NDArray[np.float64]) -> NDArray[np.float64]:
    """The oracle: least squares on all nodes."""
    basis = np.column_stack([np.ones(MESH.n_nodes), MESH.nodes - MESH.nodes.mean(axis=0)])
    return np.asarray(field - basis @ np.linalg.lstsq(basis, field, rcond=None)[0])


@pytest.mark.parallel([1, 2, 3, 4])
def test_equal_to_least_squares_on_any_number_of_ranks() -> None:
    subdomains = split(MESH, 7)
    found = measure(Team(MPI.COMM_WORLD), subdomains, CHANGE, FIELD + AFFINE)
    norms = np.linalg.norm(CHANGE, axis=1)
    expected = np.linalg.norm(CHANGE) / np.linalg.norm(without_affine_part(FIELD))
    # Of squares of 500 px, float64 leaves 1e-11 px^2 beside a field of 1 px.
    assert found.relative == pytest.approx(expected, rel=1e-8)
    assert found.rms == pytest.approx(np.sqrt((norms**2).mean()), rel=1e-9)
    assert found.largest == pytest.approx(norms.max(), rel=1e-9)
    assert int(norms.argmax()) in subdomains[found.subdomain].node_ids
    # Of whose noise nothing is said, every node counts with all of its correction.
    assert (found.known_rms, found.n_slow) == (found.rms, 0)


@pytest.mark.parallel([1, 2, 3, 4])
def test_a_node_counts_by_what_the_images_tell_of_it() -> None:
    # Deviations from far below where they count to far above, and two nodes of pure noise.
    largest = 1e-3
    deviations = np.random.default_rng(8).uniform(0.0, 4.0, MESH.n_nodes) * KNOWN_PX
    deviations[[3, 40]] = np.inf
    found = measure(Team(MPI.COMM_WORLD), split(MESH, 7), CHANGE, FIELD, deviations, largest)
    norms = np.linalg.norm(CHANGE, axis=1)
    # The largest correction that is small at each node is its tolerance.
    allowed = largest * np.maximum(1.0, deviations / KNOWN_PX)
    assert found.n_slow == (norms > allowed).sum()
    assert 0 < found.n_slow < (norms > largest).sum()
    assert found.known_rms == pytest.approx(np.sqrt(((norms * largest / allowed)**2).mean()), rel=1e-9)
    # What is told of the correction is all of it.
    assert found.rms == pytest.approx(np.sqrt((norms**2).mean()), rel=1e-9)
    assert found.largest == pytest.approx(norms.max(), rel=1e-9)


def test_no_weight_follows_noise_and_none_is_above_one() -> None:
    weights, = weigh_nodes([np.array([0.0, 0.02, 0.04, np.inf])])
    # A twentieth of 0.02 px is the tolerance of 0.001 px.
    np.testing.assert_allclose(weights, [1.0, 1.0, 0.5, 0.0])


def test_nodes_on_a_line_tell_no_gradient_across_it() -> None:
    along = np.arange(6.0)
    nodes = np.column_stack([3.0 + 2.0 * along, 40.0 - along])
    field = np.random.default_rng(4).standard_normal((6, 2))
    moments = [6.0, *nodes.sum(axis=0), *field.sum(axis=0), *(nodes.T @ nodes).ravel(),
               *(field.T @ nodes).ravel(), (field**2).sum()]
    basis = np.column_stack([np.ones(6), along])
    rest = field - basis @ np.linalg.lstsq(basis, field, rcond=None)[0]
    assert correction_size._remove_affine_part(np.array(moments)) == pytest.approx((rest**2).sum(), rel=1e-9)
    at_one_place = np.array([1.0, *nodes[0], *field[0], *np.outer(nodes[0], nodes[0]).ravel(),
                             *np.outer(field[0], nodes[0]).ravel(), (field[0]**2).sum()])
    assert correction_size._remove_affine_part(at_one_place) == pytest.approx(0.0, abs=1e-9)


def test_motion_of_the_whole_does_not_change_it() -> None:
    subdomains = split(MESH, 4)
    at_rest, moved = (measure(Team.alone(), subdomains, CHANGE, FIELD + motion) for motion in (0.0, AFFINE))
    assert moved.relative == pytest.approx(at_rest.relative, rel=1e-8)


def test_a_field_that_is_affine_is_known_to_no_relative_size() -> None:
    # What is left of |q| is rounding: 1e-16 of squares of 500 px.
    assert measure(Team.alone(), split(MESH, 1), CHANGE, AFFINE).relative > 1e2
    nothing = measure(Team.alone(), split(MESH, 1), 0.0 * CHANGE, 0.0 * AFFINE)
    assert nothing == CorrectionSize(0.0, 0.0, 0.0, 0, 0.0, 0)


def test_a_number_that_is_not_finite_is_told() -> None:
    spoiled = CHANGE.copy()
    spoiled[7, 0] = np.nan
    assert not measure(Team.alone(), split(MESH, 3), spoiled, FIELD).is_finite


@pytest.mark.parametrize(("change", "stops"), [
    ({}, True),
    ({"relative": 0.1}, True),  # the RMS is small enough
    ({"rms": 0.1, "known_rms": 0.1}, True),  # the relative one is
    ({"relative": 0.1, "rms": 0.1, "known_rms": 0.1}, False),
    ({"largest": 0.1, "n_slow": 1}, False),  # one node still moves, however small the rest
    ({"largest": 0.1}, True),  # by less than a twentieth of what it cannot know
    ({"relative": 0.1, "rms": 0.01, "largest": 0.1}, True),  # so do many: the rest is small
    ({"relative": 0.1, "rms": 0.01, "known_rms": 2e-4, "largest": 0.1}, False),  # the rest is not
])
def test_one_average_and_every_node(change: dict[str, float], stops: bool) -> None:
    tolerances = Tolerances(relative=1e-3, rms=1e-4, largest=1e-3)
    size = replace(CorrectionSize(relative=5e-4, rms=5e-5, largest=5e-4, subdomain=3, known_rms=5e-5, n_slow=0),
                   **change)
    assert size.is_below(tolerances) == stops
    if stops:
        told = size.describe_stop(tolerances)
        assert ("rms_tolerance" if size.known_rms < 1e-4 else "gauss_newton.tolerance") in told
        assert "subdomain 3" in told
        at_most = "largest_tolerance" if size.largest <= 1e-3 else "x the node's standard deviation / 0.02 px"
        assert told.endswith(at_most)


def test_a_finer_tolerance_at_nodes_loosens_no_other() -> None:
    # Deviations of 0.02 px, a twentieth of which is 1e-3 px.
    deviations = np.full(MESH.n_nodes, 0.02)
    known = [measure(Team.alone(), split(MESH, 1), CHANGE, FIELD, deviations, largest).known_rms
             for largest in (1e-3, 1e-6)]
    assert known[1] >= known[0]
