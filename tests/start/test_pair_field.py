"""A displacement through points."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.kinematics.motions import fit_affine_map
from ddic.mesh.cell_type import Q4
from ddic.mesh.cut_mesh import cut_mesh, find_points_on_own_side
from ddic.mesh.mesh import build_mesh
from ddic.mesh.structured import build_structured_mesh
from ddic.start.given_start import interpolate_pairs

MESH = build_structured_mesh((0.0, 0.0, 200.0, 100.0), 10)


def _turn(points: np.ndarray, degrees: float, scale: float = 1.0) -> np.ndarray:
    c, s = scale * np.cos(np.radians(degrees)), scale * np.sin(np.radians(degrees))
    return np.asarray(points @ np.array([[c - 1, -s], [s, c - 1]]).T + (30.0, -7.0))


def _wave(points: np.ndarray) -> np.ndarray:
    x, y = points.T
    return np.column_stack([5 * np.sin(x / 60), 3 * np.cos(y / 50)]) + _turn(points, 8.0)


def test_one_point_says_a_translation() -> None:
    found = interpolate_pairs(np.array([[50.0, 20.0]]), np.array([[3.0, -4.0]]), MESH)
    np.testing.assert_array_equal(found.displacement, np.tile((3.0, -4.0), (MESH.n_nodes, 1)))


@pytest.mark.parametrize("points", [
    [[20.0, 30.0], [150.0, 60.0]], [[0.0, 50.0], [60.0, 50.0], [100.0, 50.0], [200.0, 50.0]],
], ids=["two", "on a line"])
def test_two_points_and_points_on_a_line_say_a_rotation_with_a_scale(points: list[list[float]]) -> None:
    places = np.array(points)
    found = interpolate_pairs(places, _turn(places, 35.0, 1.1), MESH)
    np.testing.assert_allclose(found.displacement, _turn(MESH.nodes, 35.0, 1.1), atol=1e-10)


def test_three_points_say_an_affine_map() -> None:
    gradient = np.array([[0.1, -0.4], [0.3, -0.2]])
    places = np.array([[20.0, 30.0], [150.0, 60.0], [90.0, 95.0]])
    found = interpolate_pairs(places, places @ gradient.T, MESH)
    np.testing.assert_allclose(found.displacement, MESH.nodes @ gradient.T, atol=1e-10)


def test_the_same_point_twice_says_a_translation() -> None:
    of_both = fit_affine_map(np.full((2, 2), 7.0), np.array([[1.0, 2.0], [3.0, 4.0]]))
    np.testing.assert_array_equal(of_both.at(np.zeros((1, 2))), [[2.0, 3.0]])


def test_many_points_say_what_lies_between_them_though_some_are_wrong() -> None:
    random = np.random.default_rng(0)
    places = random.uniform((0, 0), (200, 100), (400, 2))
    u = _wave(places)
    u[random.choice(400, 20, replace=False)] += (40.0, -60.0)
    found = interpolate_pairs(places, u, MESH)
    inside = ((MESH.nodes > 5) & (MESH.nodes < (195, 95))).all(axis=1)
    # Twelve neighbours lie within 14 px, over which curvature, 5 px / (60 px)^2 / 2, moves the waves off a plane by
    # 0.14 px at most. Where several of the twelve are wrong, or lie on one side, they mislead by a pixel or two, of 70.
    off = np.abs(found.displacement - _wave(MESH.nodes)).max(axis=1)
    assert np.quantile(off[inside], 0.95) < 0.15
    assert off.max() < 3.0


def test_each_piece_follows_its_own_points() -> None:
    cells = MESH.cells[:, :4]
    nodes = np.vstack([MESH.nodes, MESH.nodes + np.array([0.0, 120.0]), MESH.nodes + np.array([0.0, 240.0])])
    mesh = build_mesh(nodes, {Q4: np.vstack([cells + k * MESH.n_nodes for k in range(3)])})
    # The second point lies between the first two pieces, 5 px from the second one.
    places = np.array([[50.0, 50.0], [50.0, 115.0]])
    found = interpolate_pairs(places, np.array([[1.0, 0.0], [0.0, 60.0]]), mesh)
    assert found.n_pieces_without == 1
    expected = np.repeat([[1.0, 0.0], [0.0, 60.0], [0.0, 60.0]], MESH.n_nodes, axis=0)
    np.testing.assert_array_equal(found.displacement, expected)


def test_points_on_either_side_of_a_line_stay_there() -> None:
    line = np.array([[-10.0, 47.3], [210.0, 52.6]])
    mesh = cut_mesh(MESH, [line]).mesh
    is_below = find_points_on_own_side(mesh)[:, 1] > 49.95 + (find_points_on_own_side(mesh)[:, 0] - 100) * 5.3 / 220
    # Two points 2 px from the line, on its two sides.
    places = np.array([[100.0, 48.0], [100.0, 52.0]])
    found = interpolate_pairs(places, np.array([[0.0, -20.0], [0.0, 20.0]]), mesh)
    np.testing.assert_array_equal(found.displacement[:, 1], np.where(is_below, 20.0, -20.0))
    assert found.n_pieces_without == 0
