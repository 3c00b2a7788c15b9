"""A displacement beyond where it is known."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.functionals.regularization import Material, assemble_stiffness
from ddic.mesh.cell_type import Q4
from ddic.mesh.cut_mesh import cut_mesh, find_points_on_own_side
from ddic.mesh.mesh import Mesh, build_mesh
from ddic.mesh.structured import build_structured_mesh
from ddic.start.given_start import extrapolate

MESH = build_structured_mesh((0.0, 0.0, 200.0, 100.0), 10)
KNOWN = MESH.nodes[:, 0] < 121


def _turn(points: np.ndarray, degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.asarray(points @ np.array([[c - 1, -s], [s, c - 1]]).T + (30.0, -7.0))


def _two_pieces() -> tuple[Mesh, np.ndarray]:
    """The mesh and a copy of it 200 px below; whether a node is of the first."""
    below = MESH.nodes + np.array([0.0, 200.0])
    cells = MESH.cells[:, :4]
    mesh = build_mesh(np.vstack([MESH.nodes, below]), {Q4: np.vstack([cells, cells + MESH.n_nodes])})
    return mesh, np.arange(mesh.n_nodes) < MESH.n_nodes


@pytest.mark.parametrize("degrees", [0.0, 5.0, 90.0])
def test_rotations_with_strain_go_on_exactly(degrees: float) -> None:
    u = _turn(MESH.nodes, degrees) + MESH.nodes @ np.array([[0.02, 0.0], [0.01, -0.006]])
    found = extrapolate(MESH, np.where(KNOWN[:, None], u, np.nan), KNOWN)
    # Least squares of an affine map: rounding of numbers of 200.
    np.testing.assert_allclose(found.displacement, u, atol=1e-10)
    assert found.n_pieces_without == 0


def test_what_is_known_stays_and_the_rest_is_in_equilibrium() -> None:
    x, y = MESH.nodes.T
    u = np.column_stack([np.sin(x / 40) * y / 50, np.cos(y / 30)])
    found = extrapolate(MESH, u, KNOWN).displacement
    np.testing.assert_array_equal(found[KNOWN], u[KNOWN])
    # Forces of an affine map are 0 inside; at the edge those of its constant stress are left.
    inside = ~KNOWN & (x < 199) & (y > 1) & (y < 99)
    forces = (assemble_stiffness(MESH, Material()) @ found.ravel()).reshape(-1, 2)
    assert np.abs(forces[inside]).max() < 1e-6 * np.abs(forces).max()


def test_nothing_jumps_at_the_border() -> None:
    x, y = MESH.nodes.T
    u = np.column_stack([np.sin(x / 40), np.cos(y / 30)])
    found = extrapolate(MESH, u, KNOWN).displacement
    first, second = np.flatnonzero((x == 120) & (y == 50)), np.flatnonzero((x == 130) & (y == 50))
    # Within a cell it changes by no more than the known field does at its steepest, 10 px / 30 px.
    assert np.abs(found[first] - found[second]).max() < 0.33


def test_a_piece_that_is_known_nowhere_moves_with_the_nearest() -> None:
    mesh, is_first = _two_pieces()
    u = _turn(mesh.nodes, 12.0)
    found = extrapolate(mesh, u, is_first & (mesh.nodes[:, 0] < 100))
    np.testing.assert_allclose(found.displacement, u, atol=1e-9)
    assert found.n_pieces_without == 1


def test_pieces_go_on_by_themselves() -> None:
    mesh, is_first = _two_pieces()
    u = np.where(is_first[:, None], _turn(mesh.nodes, 12.0), -_turn(mesh.nodes, 40.0))
    found = extrapolate(mesh, u, mesh.nodes[:, 0] < 100)
    np.testing.assert_allclose(found.displacement, u, atol=1e-9)


def test_one_known_node_says_a_translation() -> None:
    known = np.zeros(MESH.n_nodes, dtype=bool)
    known[17] = True
    found = extrapolate(MESH, np.tile((3.0, -4.0), (MESH.n_nodes, 1)), known)
    np.testing.assert_allclose(found.displacement, np.tile((3.0, -4.0), (MESH.n_nodes, 1)), atol=1e-12)


def test_sides_of_a_line_go_on_by_themselves() -> None:
    mesh = cut_mesh(MESH, [np.array([[-10.0, 47.3], [210.0, 52.6]])]).mesh
    on_own_side = find_points_on_own_side(mesh)
    is_below = on_own_side[:, 1] > 49.95 + (on_own_side[:, 0] - 100) * 5.3 / 220
    u = np.where(is_below[:, None], _turn(mesh.nodes, 10.0), 0.01 * mesh.nodes)
    found = extrapolate(mesh, u, on_own_side[:, 0] < 121)
    np.testing.assert_allclose(found.displacement, u, atol=1e-9)
