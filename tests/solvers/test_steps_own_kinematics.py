"""Unknowns that are not displacements of nodes: every way to solve Eq. 11 of [BP17] finds the same."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy import sparse

from ddic.kinematics.linear import LinearRegion
from ddic.mesh.mesh import Mesh
from ddic.parallel.team import Team
from ddic.solvers.correction_size import measure_unit_size
from ddic.solvers.dual.dual_step import DualSettings
from ddic.solvers.dual.preconditioner import Preconditioner
from ddic.solvers.exchange import average_copies
from ddic.solvers.linear_step import LinearStep
from ddic.solvers.whole_system import AssembledStep, ConjugateGradientStep
from support.linear import Decomposed, linear_step, one_domain_solution, split

RANKS = [1, 2, 3, 4]
# The Krylov residual is 1e-12 of the right-hand side, condition numbers stay below 1e4.
SAME = 1e-9


def fix_every_third_along_y(mesh: Mesh) -> LinearRegion:
    """Two unknowns at most nodes, one at every third, which is fixed along y."""
    moves = np.ones(mesh.nodes.shape, dtype=bool)
    moves[::3, 1] = False
    free = np.flatnonzero(moves)
    matrix = sparse.csr_matrix((np.ones(len(free)), (free, np.arange(len(free)))), shape=(mesh.n_dofs, len(free)))
    return LinearRegion(mesh, matrix)


def bend_whole_region(mesh: Mesh) -> LinearRegion:
    """Rigid motion, affine strain and six bending modes of the whole region, which all subdomains share."""
    x, y = ((mesh.nodes - mesh.nodes.mean(axis=0)) / np.ptp(mesh.nodes, axis=0)).T
    nothing = np.zeros_like(x)
    modes = [(x**0, nothing), (nothing, x**0), (x, nothing), (y, nothing), (nothing, x), (nothing, y)]
    for wave in range(1, 4):
        bend = np.cos(wave * np.pi * (x + 0.5))
        modes += [(bend, nothing), (nothing, bend)]
    columns = [np.stack(mode, axis=1).ravel() for mode in modes]
    return LinearRegion(mesh, sparse.csr_matrix(np.stack(columns, axis=1)))


KINEMATICS = [fix_every_third_along_y, bend_whole_region]


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("wavelength", [None, 32.0])
@pytest.mark.parametrize("unknowns", KINEMATICS)
def test_whole_region_solvers_equal_monolithic(unknowns: Callable[[Mesh], LinearRegion],
                                               wavelength: float | None) -> None:
    nodal = linear_step(wavelength=wavelength)
    problem = nodal.with_unknowns(unknowns(nodal.mesh))
    parts = split(problem.mesh, "metis", 9)
    reference = one_domain_solution(problem, parts, "consistent")
    with Decomposed(Team.world(), problem, parts, "consistent") as cut:
        errors = []
        steps: list[LinearStep] = [AssembledStep(cut.team, cut.systems, 0.0),
                                   ConjugateGradientStep(cut.team, cut.systems, 1e-11, 2000)]
        for step in steps:
            errors.append(cut.relative_error(cut.solve(step).dq, reference))
            step.destroy()
    assert max(errors) <= SAME


@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("wavelength", [None, 32.0])
@pytest.mark.parametrize("preconditioner", ["none", "paper", "scaled", "two_level"])
def test_dual_equals_monolithic_with_fewer_unknowns_at_some_nodes(preconditioner: Preconditioner,
                                                                  wavelength: float | None) -> None:
    nodal = linear_step(wavelength=wavelength)
    problem = nodal.with_unknowns(fix_every_third_along_y(nodal.mesh))
    parts = split(problem.mesh, "metis", 9)
    reference = one_domain_solution(problem, parts, "consistent")
    with Decomposed(Team.world(), problem, parts, "consistent") as cut:
        result = cut.solve(cut.step(DualSettings(preconditioner, 1e-12, 3000)))
        error = cut.relative_error(result.dq, reference)
        rms = result.dq.measure_rms()
    assert error <= SAME
    assert result.krylov_iterations > 0
    # Of nodes and not of unknowns, each node counted once.
    expected = np.sqrt((reference**2).sum() / problem.mesh.n_nodes)
    assert rms == pytest.approx(expected, rel=1e-8)


@pytest.mark.parallel(RANKS)
def test_dual_equals_monolithic_where_all_subdomains_share_all_unknowns() -> None:
    nodal = linear_step()
    problem = nodal.with_unknowns(bend_whole_region(nodal.mesh))
    parts = split(problem.mesh, "blocks", 4)
    reference = one_domain_solution(problem, parts, "consistent")
    with Decomposed(Team.world(), problem, parts, "consistent") as cut:
        step = cut.step(DualSettings("scaled", 1e-12, 3000))
        error = cut.relative_error(cut.solve(step).dq, reference)
    # Three rows for each unknown of four subdomains.
    assert step.n_interface == 3 * problem.region.n_unknowns
    assert error <= SAME


@pytest.mark.parallel(RANKS)
def test_unit_size_is_that_of_displacements() -> None:
    nodal = linear_step()
    parts = split(nodal.mesh, "metis", 9)
    regions = [nodal.region, fix_every_third_along_y(nodal.mesh), bend_whole_region(nodal.mesh)]
    for region in regions:
        problem = nodal.with_unknowns(region)
        with Decomposed(Team.world(), problem, parts, "consistent") as cut:
            found = measure_unit_size(cut.team, cut.subdomains)
        tangent = np.eye(nodal.mesh.n_dofs) if region is nodal.region else region.matrix.toarray()
        squares = (tangent**2).sum(axis=0)
        assert found == pytest.approx(np.sqrt(squares.mean() / nodal.mesh.n_nodes), rel=1e-12)


@pytest.mark.parallel(RANKS)
def test_jumps_of_modes_are_told_in_pixels() -> None:
    nodal = linear_step()
    region = LinearRegion(nodal.mesh, 3.0 * bend_whole_region(nodal.mesh).matrix)
    problem = nodal.with_unknowns(region)
    with Decomposed(Team.world(), problem, split(problem.mesh, "blocks", 4), "consistent") as cut:
        # The first unknown moves everything by 3 px; copies of it differ by 0.1 from subdomain to subdomain.
        q = [np.where(np.arange(s.n_field) == 0, 0.1 * s.index, 0.0) for s in cut.subdomains]
        found = average_copies(cut.field(q))
    assert found.largest_jump == pytest.approx(0.9, rel=1e-12)
    assert all(q_s[0] == pytest.approx(0.15, rel=1e-12) for q_s in found.q)
