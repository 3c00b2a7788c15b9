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
from ddic.parallel.team import Team
from ddic.partition.build_subdomains import build_subdomains
from ddic.partition.subdomain import Subdomain
from ddic.solvers.correction_size import CorrectionSize, Tolerances, measure_correction
from support.pictures import square_mesh

MESH = square_mesh(1000.0, 1144.0)
RNG = np.random.default_rng(5)
FIELD, CHANGE = RNG.normal(size=(2, MESH.n_nodes, 2))
CHANGE *= 1e-3
AFFINE = np.array([150.0, -120.0]) + MESH.nodes @ np.array([[0.05, 0.3], [-0.25, -0.02]])


def split(mesh: Mesh, n_subdomains: int) -> list[Subdomain]:
    parts = np.arange(mesh.n_cells) % n_subdomains
    return build_subdomains(NodalRegion(mesh), parts, np.zeros(mesh.n_dofs, dtype=bool))


def measure(team: Team, subdomains: list[Subdomain], change: NDArray[np.float64],
            field: NDArray[np.float64]) -> CorrectionSize:
    own = split_evenly(np.ones(len(subdomains)), team.size)[team.rank]
    mine = [subdomains[k] for k in own]
    return measure_correction(team, mine, [change[s.node_ids].ravel() for s in mine],
                              [(field - change)[s.node_ids].ravel() for s in mine])


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


def test_motion_of_the_whole_does_not_change_it() -> None:
    subdomains = split(MESH, 4)
    at_rest, moved = (measure(Team.alone(), subdomains, CHANGE, FIELD + motion) for motion in (0.0, AFFINE))
    assert moved.relative == pytest.approx(at_rest.relative, rel=1e-8)


def test_a_field_that_is_affine_is_known_to_no_relative_size() -> None:
    # What is left of |q| is rounding: 1e-16 of squares of 500 px.
    assert measure(Team.alone(), split(MESH, 1), CHANGE, AFFINE).relative > 1e2
    nothing = measure(Team.alone(), split(MESH, 1), 0.0 * CHANGE, 0.0 * AFFINE)
    assert nothing == CorrectionSize(0.0, 0.0, 0.0, 0)


def test_a_number_that_is_not_finite_is_told() -> None:
    spoiled = CHANGE.copy()
    spoiled[7, 0] = np.nan
    assert not measure(Team.alone(), split(MESH, 3), spoiled, FIELD).is_finite


@pytest.mark.parametrize(("change", "stops"), [
    ({}, True),
    ({"relative": 0.1}, True),  # the RMS is small enough
    ({"rms": 0.1}, True),  # the relative one is
    ({"relative": 0.1, "rms": 0.1}, False),
    ({"largest": 0.1}, False),  # one node still moves, however small the rest
])
def test_one_average_and_every_node(change: dict[str, float], stops: bool) -> None:
    tolerances = Tolerances(relative=1e-3, rms=1e-4, largest=1e-3)
    size = replace(CorrectionSize(relative=5e-4, rms=5e-5, largest=5e-4, subdomain=3), **change)
    assert size.is_below(tolerances) == stops
    if stops:
        told = size.describe_stop(tolerances)
        assert ("rms_tolerance" if size.rms < 1e-4 else "gauss_newton.tolerance") in told
        assert "subdomain 3" in told
