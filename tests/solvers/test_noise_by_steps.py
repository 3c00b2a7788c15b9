"""The noise floor estimated by linear steps, against the trace itself."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

from ddic.parallel.team import Team
from ddic.partition.sharing import build_subdomains
from ddic.solvers.dual.dual_step import DualSettings
from ddic.solvers.linear_step import LinearStep
from ddic.solvers.probing import estimate_deviation, estimate_response
from support.linear import Decomposed, dense, linear_step, split

SIGMA = 2.0


@cache
def _exact(wavelength: float | None) -> float:
    """sqrt(2 sigma^2 trace(A^-1 M A^-1) / n) of the whole problem, pixels."""
    problem = linear_step(12, wavelength)
    whole = build_subdomains(problem.region, np.zeros(problem.mesh.n_cells, np.int64), problem.controlled)[0]
    system = problem.system(whole, np.ones(problem.mesh.n_dofs))
    inverse = np.linalg.inv(dense(system.operator))
    covariance = 2 * SIGMA**2 * inverse @ dense(system.hessian) @ inverse
    return float(np.sqrt(np.trace(covariance) / len(covariance)))


def _estimate(parts: Decomposed, step: LinearStep, counted: list[NDArray[np.bool_]] | None = None) -> float:
    return SIGMA * estimate_response(Team(MPI.COMM_WORLD), parts.systems, step, counted).rms_per_grey


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("wavelength", [None, 40.0])
def test_unknowns_that_the_images_determine_are_counted(wavelength: float | None) -> None:
    problem, team = linear_step(12, wavelength), Team(MPI.COMM_WORLD)
    whole = build_subdomains(problem.region, np.zeros(problem.mesh.n_cells, np.int64), problem.controlled)[0]
    system = problem.system(whole, np.ones(problem.mesh.n_dofs))
    expected = np.trace(np.linalg.solve(dense(system.operator), dense(system.hessian)))
    with Decomposed(team, problem, split(problem.mesh, "blocks", 4), "consistent") as parts:
        response = estimate_response(team, parts.systems, parts.step(DualSettings("scaled")))
    # Signs alone are exact without a regularization, but for the tenth that a step may leave of a solution; with one
    # four vectors leave sqrt(2 / (4 x 60)).
    assert response.n_determined == pytest.approx(expected, rel=0.03 if wavelength is None else 0.15)


@pytest.mark.parallel([1, 2, 3, 4])
@pytest.mark.parametrize("wavelength", [None, 40.0])
def test_it_is_that_of_the_covariance_whatever_the_partition(wavelength: float | None) -> None:
    problem, team = linear_step(12, wavelength), Team(MPI.COMM_WORLD)
    found = []
    for kind, n in (("blocks", 4), ("metis", 7)):
        with Decomposed(team, problem, split(problem.mesh, kind, n), "consistent") as parts:
            step = parts.step(DualSettings("scaled"))
            found.append(_estimate(parts, step))
    # Four vectors of 338 signs, of which neighbours' go together: 3 % at one standard deviation.
    assert found[0] == pytest.approx(_exact(wavelength), rel=0.06)
    # The signs are the nodes': another partition changes what a step may leave alone.
    assert found[1] == pytest.approx(found[0], rel=0.01)


@pytest.mark.parallel([1, 2, 3])
@pytest.mark.parametrize("wavelength", [None, 40.0])
def test_nodes_that_do_not_count_have_no_part_in_it(wavelength: float | None) -> None:
    problem, team = linear_step(12, wavelength), Team(MPI.COMM_WORLD)
    whole = build_subdomains(problem.region, np.zeros(problem.mesh.n_cells, np.int64), problem.controlled)[0]
    system = problem.system(whole, np.ones(problem.mesh.n_dofs))
    inverse = np.linalg.inv(dense(system.operator))
    diagonal = np.diag(2 * SIGMA**2 * inverse @ dense(system.hessian) @ inverse).reshape(-1, 2)
    # Those at the edges, which have most of the noise, and a node in the middle that has little.
    low, high = problem.mesh.nodes.min(axis=0) + 6.0, problem.mesh.nodes.max(axis=0) - 6.0
    counted = ((problem.mesh.nodes > low) & (problem.mesh.nodes < high)).all(axis=1)
    counted[len(counted) // 2] = False
    expected = float(np.sqrt(diagonal[counted].mean()))
    # Guards the test.
    assert expected < 0.95 * float(np.sqrt(diagonal.mean()))
    with Decomposed(team, problem, split(problem.mesh, "blocks", 4), "consistent") as parts:
        step = parts.step(DualSettings("scaled"))
        found = _estimate(parts, step, [counted[s.node_ids] for s in parts.subdomains])
        of_all = _estimate(parts, step, [np.ones(len(s.node_ids), dtype=bool) for s in parts.subdomains])
        without = _estimate(parts, step)
    # As above, with fewer signs.
    assert found == pytest.approx(expected, rel=0.08)
    # Steps leave a share of what they solve, another one from another start.
    assert of_all == pytest.approx(without, rel=0.01)


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("wavelength", [None, 40.0])
def test_a_combination_of_displacements_has_the_deviation_of_the_covariance(wavelength: float | None) -> None:
    problem, team = linear_step(12, wavelength), Team(MPI.COMM_WORLD)
    whole = build_subdomains(problem.region, np.zeros(problem.mesh.n_cells, np.int64), problem.controlled)[0]
    system = problem.system(whole, np.ones(problem.mesh.n_dofs))
    inverse = np.linalg.inv(dense(system.operator))
    covariance = 2 * inverse @ dense(system.hessian) @ inverse
    # How far two nodes are from each other along x.
    factors = np.zeros(problem.mesh.nodes.shape)
    factors[[20, 90], 0] = 1.0, -1.0
    expected = float(np.sqrt(factors.ravel() @ covariance @ factors.ravel()))
    with Decomposed(team, problem, split(problem.mesh, "blocks", 4), "consistent") as parts:
        loads = [factors[s.node_ids] / s.node_multiplicity[:, None] for s in parts.subdomains]
        found = estimate_deviation(team, parts.systems, parts.step(DualSettings("scaled")), loads)
    # A step may leave a tenth of what it solves; it leaves less.
    assert found == pytest.approx(expected, rel=0.05)
