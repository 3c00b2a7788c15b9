"""Elastic matter in place of what a frame does not show."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import spsolve

from ddic.functionals.regularization import Material, integrate_cell_stiffness
from ddic.kinematics.nodal import NodalRegion
from ddic.mesh.mesh import Mesh
from ddic.mesh.rotation import Rotation, build_rotation
from ddic.parallel.distribution import split_evenly
from ddic.parallel.field import Field
from ddic.parallel.team import Team
from ddic.partition.sharing import build_subdomains
from ddic.partition.split import split_by_blocks
from ddic.partition.subdomain import Subdomain
from ddic.problem.added_forces import HELD, STIFFNESS, FilledCells, fill_cells, fit_rigid_motion
from support.pictures import square_mesh

Array = NDArray[np.float64]
MESH = square_mesh(24.0, 168.0)
"""9 x 9 cells of 16 px."""

WEIGHT = 5e4
RANDOM = np.random.default_rng(0)


@cache
def alone() -> tuple[Subdomain, ...]:
    return cut(MESH, (1, 1))


def cut(mesh: Mesh, blocks: tuple[int, int]) -> tuple[Subdomain, ...]:
    parts = split_by_blocks(mesh, blocks)
    return tuple(build_subdomains(NodalRegion(mesh), parts, np.zeros(mesh.n_dofs, dtype=bool)))


def hole(mesh: Mesh, low: float = 70.0, high: float = 125.0) -> NDArray[np.bool_]:
    """Cells whose middle lies in a square."""
    return np.asarray(((mesh.centroids > low) & (mesh.centroids < high)).all(axis=1))


def fill(angle: float = 0.0, chosen: NDArray[np.bool_] | None = None) -> FilledCells:
    return fill_cells(alone(), [hole(MESH) if chosen is None else chosen], WEIGHT, Rotation(np.array([angle])))


def field(of: Array) -> Field:
    return Field(Team.alone(), alone(), [of])


def turned(angle: float, shift: tuple[float, float] = (0.0, 0.0)) -> Array:
    arms = MESH.nodes - MESH.nodes.mean(axis=0)
    return np.asarray(arms @ (build_rotation(angle) - np.eye(2)).T + shift).ravel()


@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_stiffness_is_the_sum_over_filled_cells(angle: float) -> None:
    chosen = hole(MESH)
    of_cells = integrate_cell_stiffness(MESH, Material())
    expected = np.zeros((MESH.n_dofs, MESH.n_dofs))
    turn = np.kron(np.eye(4), build_rotation(angle))
    for cell in np.flatnonzero(chosen):
        dofs = (2 * MESH.connectivity.reshape(-1, 4)[cell][:, None] + np.arange(2)).ravel()
        expected[np.ix_(dofs, dofs)] += STIFFNESS * WEIGHT * turn @ of_cells[cell] @ turn.T
    filled = fill(angle)
    np.testing.assert_allclose(filled.stiffness[0].toarray(), expected, atol=1e-12 * np.abs(expected).max())
    held = HELD * WEIGHT * (np.diag(expected) > 0)
    np.testing.assert_allclose(filled.assemble_operator(0).toarray(), expected + np.diag(held),
                               atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("angle", [0.0, 0.3, 2.0])
def test_forces_are_minus_the_gradient_of_the_energy(angle: float) -> None:
    # Whatever the operators were turned by.
    filled = fill(0.1)
    k = fill(0.0).stiffness[0]
    q = turned(angle, (3.0, -2.0)) + RANDOM.normal(0.0, 0.05, MESH.n_dofs)

    def energy(of: Array) -> float:
        motion = fit_rigid_motion(field(of))
        rest = ((of.reshape(-1, 2) - motion.evaluate(MESH.nodes)) @ motion.rotation.matrix).ravel()
        return float(0.5 * rest @ (k @ rest))

    (forces,) = filled.compute_forces(field(q))
    step = 1e-3
    for _ in range(5):
        direction = RANDOM.normal(size=MESH.n_dofs)
        slope = (energy(q + step * direction) - energy(q - step * direction)) / (2 * step)
        # The turn of the region by dq costs the matter in the hole its turn about the strain there, of 0.003, which the
        # forces leave out.
        assert slope == pytest.approx(-forces @ direction, rel=1e-3)


@pytest.mark.parametrize("angle", [0.0, 0.05, 0.8, 3.0])
def test_a_rigid_motion_costs_nothing(angle: float) -> None:
    # A stiffness that was turned by a multiple of a step holds for angles about it.
    for of_stiffness in (angle, angle - 0.05):
        (forces,) = fill(of_stiffness).compute_forces(field(turned(angle, (40.0, -70.0))))
        # Stiffness times a strain of 1 is 5; rounding of 100 px to 1e-14.
        assert np.abs(forces).max() <= 1e-11


def test_what_is_turned_and_stretched_has_turned_forces() -> None:
    strain = np.array([[0.02, 0.01], [0.01, -0.015]])
    arms = MESH.nodes - MESH.nodes.mean(axis=0)
    (at_rest,) = fill(0.0).compute_forces(field((arms @ strain).ravel()))
    angle = 0.6
    moved = (arms + arms @ strain) @ build_rotation(angle).T
    (forces,) = fill(angle).compute_forces(field((moved - arms).ravel()))
    # The nearest rigid motion of a symmetric stretch is its rotation.
    np.testing.assert_allclose(forces.reshape(-1, 2), at_rest.reshape(-1, 2) @ build_rotation(angle).T,
                               atol=1e-9 * np.abs(at_rest).max())
    assert np.abs(at_rest).max() > 0


def test_a_hole_in_a_linear_field_has_that_field() -> None:
    chosen = hole(MESH)
    linear = ((MESH.nodes - 96.0) @ np.array([[0.01, 0.02], [-0.015, 0.005]]) + (3.0, -1.0)).ravel()
    seen_nodes = np.unique(MESH.connectivity.reshape(-1, 4)[~chosen])
    is_free = np.ones(MESH.n_nodes, dtype=bool)
    is_free[seen_nodes] = False
    free = np.repeat(is_free, 2)
    assert free.sum() == 2 * 4  # 3 x 3 cells have 2 x 2 inner nodes
    filled = fill()
    q = np.where(free, 0.0, linear)
    # Newton with what is given as the operator: the forces take account of the rigid motion, which the start spoils.
    operator = filled.stiffness[0][free][:, free].tocsc()
    for _ in range(4):
        q[free] += spsolve(operator, filled.compute_forces(field(q))[0][free])
    np.testing.assert_allclose(q, linear, atol=1e-9)


def test_cells_that_are_seen_move_by_the_stated_share() -> None:
    # M of seen cells holds their nodes at a field that is not linear: the filled ones pull by 1e-4 of it.
    chosen = hole(MESH)
    x, y = MESH.nodes.T
    wave = np.column_stack([np.sin(x / 15.0), np.cos(y / 15.0)]).ravel()
    seen = np.repeat(np.isin(np.arange(MESH.n_nodes), MESH.connectivity.reshape(-1, 4)[~chosen]), 2)
    filled = fill()
    m = sparse.diags(WEIGHT * seen.astype(float))
    q = np.where(seen, wave, 0.0)
    operator = (m + filled.stiffness[0] + sparse.diags(1e-12 * WEIGHT * np.ones(MESH.n_dofs))).tocsc()
    for _ in range(20):
        q = q + spsolve(operator, m @ (wave - q) + filled.compute_forces(field(q))[0])
    # Fields of 1 px on cells of stiffness 1 within a factor of a few.
    assert 1e-6 < np.abs(q - wave)[seen].max() < 5 * STIFFNESS


def test_forces_do_not_depend_on_where_operators_were_assembled() -> None:
    q = turned(0.3) + RANDOM.normal(0.0, 0.1, MESH.n_dofs)
    one, other = (fill(angle).compute_forces(field(q))[0] for angle in (0.3, 0.27))
    np.testing.assert_array_equal(one, other)


@pytest.mark.parallel([1, 3])
def test_subdomains_add_up_to_the_whole() -> None:
    team = Team.world()
    everything = cut(MESH, (3, 3))
    own = [everything[k] for k in split_evenly(np.ones(9), team.size)[team.rank]]
    chosen = hole(MESH)
    random = np.random.default_rng(3)
    q = turned(0.2) + random.normal(0.0, 0.1, MESH.n_dofs)
    (expected,) = fill(0.2).compute_forces(field(q))
    filled = fill_cells(own, [chosen[s.cell_ids] for s in own], WEIGHT, Rotation(np.array([0.2])))
    total = np.zeros(MESH.n_dofs)
    for s, forces in zip(own, filled.compute_forces(Field(team, own, [q[s.numbers] for s in own])), strict=True):
        np.add.at(total, s.numbers, forces)
    np.testing.assert_allclose(team.sum(total), expected, atol=1e-10 * np.abs(expected).max())


def test_a_subdomain_that_is_hidden_altogether_is_not_singular() -> None:
    filled = fill(0.3, np.ones(MESH.n_cells, dtype=bool))
    operator = filled.assemble_operator(0)
    lowest = np.linalg.eigvalsh(operator.toarray())[:4]
    # Three rigid motions, which no stiffness holds, and the softest bending.
    np.testing.assert_allclose(lowest[:3], HELD * WEIGHT, rtol=1e-3)
    assert lowest[3] > 10 * HELD * WEIGHT
    # Where nothing is filled, nothing is held.
    nothing = fill(0.3, np.zeros(MESH.n_cells, dtype=bool))
    assert nothing.assemble_operator(0).count_nonzero() == 0
