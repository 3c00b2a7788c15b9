"""Strains at cell centres."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings

from ddic.kinematics.strain import compute_strain, find_inverted_cells
from ddic.mesh.mesh import Mesh
from support.random_meshes import SEEDS, Cells, grid_mesh, grid_meshes


@settings(max_examples=40)
@given(mesh=grid_meshes(), seed=SEEDS)
def test_uniform_gradients_are_exact(mesh: Mesh, seed: int) -> None:
    h = np.random.default_rng(seed).uniform(-0.3, 0.3, (2, 2))
    strain = compute_strain(mesh, (mesh.nodes @ h.T + [3.0, -5.0]).ravel())
    small, large = (h + h.T) / 2, (h + h.T + h.T @ h) / 2
    # Rounding of displacements of some ten pixels over cells of two.
    for found, tensor in ((strain.infinitesimal, small), (strain.green_lagrange, large)):
        expected = np.tile([tensor[0, 0], tensor[1, 1], tensor[0, 1]], (mesh.n_cells, 1))
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_rotation_has_no_green_lagrange_strain() -> None:
    mesh = grid_mesh(3, 3, (7.0, 6.0), cells="mixed", seed=1, jitter=0.2)
    c, s = np.cos(0.4), np.sin(0.4)
    rotation = np.array([[c, -s], [s, c]])
    strain = compute_strain(mesh, (mesh.nodes @ rotation.T - mesh.nodes).ravel())
    np.testing.assert_allclose(strain.green_lagrange, 0.0, atol=1e-14)
    np.testing.assert_allclose(strain.infinitesimal, np.tile([c - 1, c - 1, 0.0], (mesh.n_cells, 1)), atol=1e-14)


@pytest.mark.parametrize(("cells", "order"), [("Q4", 2.0), ("T3", 1.0)])
def test_strain_converges(cells: Cells, order: float) -> None:
    # The centre of a Q4 is superconvergent (order 2); in a T3 the strain is constant (order 1).
    errors = []
    for n in (16, 32):
        mesh = grid_mesh(n, n, (64.0 / n, 64.0 / n), cells=cells)
        w = 2 * np.pi / 64
        x, y = mesh.nodes.T
        u = np.stack([np.sin(w * x) * np.cos(w * y), 0.5 * np.cos(w * (x + y))], axis=1)
        x, y = mesh.centroids.T
        exx = w * np.cos(w * x) * np.cos(w * y)
        eyy = -0.5 * w * np.sin(w * (x + y))
        exy = 0.5 * (-w * np.sin(w * x) * np.sin(w * y) - 0.5 * w * np.sin(w * (x + y)))
        found = compute_strain(mesh, u.ravel()).infinitesimal
        errors.append(np.abs(found - np.stack([exx, eyy, exy], axis=1)).max() / w)
    assert errors[0] < 0.3
    # Two grids are not yet the limit.
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.2)


def test_a_cell_turned_inside_out_is_named() -> None:
    mesh = grid_mesh(3, 3, (7.0, 6.0), cells="Q4", seed=1, jitter=0.0)
    q = np.zeros(mesh.n_dofs)
    assert len(find_inverted_cells(mesh, q)) == 0
    # Mirrored in x about its centroid, cell 4 has det(I + grad u) = -1; its neighbours are stretched, not turned.
    corners = mesh.cells[4]
    q.reshape(-1, 2)[corners, 0] = -2 * (mesh.nodes[corners, 0] - mesh.centroids[4, 0])
    assert 4 in find_inverted_cells(mesh, q)
    assert 0 not in find_inverted_cells(mesh, q)
