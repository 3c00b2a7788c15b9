"""Displacements without their rigid motion, and how far they can be magnified."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.kinematics.strain import count_folded_cells, find_largest_gradient, project_rigid_motion_out
from support.random_meshes import grid_mesh

MESH = grid_mesh(8, 6, (10.0, 9.0), origin=(100.0, 50.0), cells="mixed", jitter=0.15, seed=2)


def rotation(degrees: float) -> np.ndarray:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[c, -s], [s, c]])


@pytest.mark.parametrize("degrees", [0.0, 3.0, 90.0, 170.0])
def test_rotations_and_translations_leave_nothing(degrees: float) -> None:
    moved = MESH.nodes @ rotation(degrees).T + [7.0, -300.0]
    np.testing.assert_allclose(project_rigid_motion_out(MESH.nodes, moved - MESH.nodes), 0.0, atol=1e-12)


def test_what_is_left_is_in_the_axes_at_rest() -> None:
    stretch = np.array([[0.02, 0.005], [0.005, -0.01]])
    # A symmetric stretch does not turn nodes that lie in a square.
    nodes = grid_mesh(6, 6, (10.0, 10.0), origin=(100.0, 50.0)).nodes
    moved = (nodes @ (np.eye(2) + stretch)) @ rotation(35.0).T + [4.0, 5.0]
    found = project_rigid_motion_out(nodes, moved - nodes)
    np.testing.assert_allclose(found, (nodes - nodes.mean(axis=0)) @ stretch, atol=1e-12)


def test_no_cell_folds_below_the_limit_and_one_does_beyond_the_largest_squeeze() -> None:
    rng = np.random.default_rng(1)
    noise = rng.normal(size=MESH.nodes.shape)
    limit = 1.0 / find_largest_gradient(MESH, noise)
    assert count_folded_cells(MESH, MESH.nodes + 0.99 * limit * noise) == 0
    assert count_folded_cells(MESH, MESH.nodes + 20 * limit * noise) > 0
    squeeze = np.zeros(MESH.nodes.shape)
    squeeze[:, 0] = -0.1 * MESH.nodes[:, 0]
    assert find_largest_gradient(MESH, squeeze) == pytest.approx(0.1)
    assert count_folded_cells(MESH, MESH.nodes + 9.99 * squeeze) == 0
    assert count_folded_cells(MESH, MESH.nodes + 10.01 * squeeze) == MESH.n_cells
