"""Displacement gradients at nodes: exact where they can be, and never worse than those of the cells."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from numpy.typing import NDArray

from ddic.kinematics.nodal_gradients import recover_gradients
from ddic.kinematics.strain import compute_displacement_gradients
from ddic.mesh.cell_type import T3
from ddic.mesh.cut_mesh import cut_mesh
from ddic.mesh.interpolation import interpolate, locate
from ddic.mesh.mesh import Mesh, build_mesh
from ddic.mesh.structured import build_structured_mesh
from support.random_meshes import SEEDS, Cells, grid_mesh, grid_meshes

Array = NDArray[np.float64]
SIDE = 64.0
W = 2 * np.pi / SIDE


def recover(mesh: Mesh, u: Array) -> Array:
    return recover_gradients([mesh], [u.ravel()], list)[0]


def wave(points: Array) -> Array:
    x, y = points.T
    return np.stack([np.sin(W * x) * np.cos(W * y), 0.5 * np.cos(W * (x + y))], axis=1)


def gradient_of_wave(points: Array) -> Array:
    x, y = points.T
    first = np.stack([np.cos(W * x) * np.cos(W * y), -np.sin(W * x) * np.sin(W * y)], axis=1)
    second = np.stack([-0.5 * np.sin(W * (x + y))] * 2, axis=1)
    return W * np.stack([first, second], axis=1)


def rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))


@settings(max_examples=40)
@given(mesh=grid_meshes(), seed=SEEDS)
def test_linear_displacements_are_exact_at_every_node(mesh: Mesh, seed: int) -> None:
    h = np.random.default_rng(seed).uniform(-0.3, 0.3, (2, 2))
    found = recover(mesh, mesh.nodes @ h.T + [3.0, -5.0])
    # Rounding of displacements of some ten pixels over cells of two.
    np.testing.assert_allclose(found, np.broadcast_to(h, found.shape), rtol=0, atol=1e-11)


@pytest.mark.parametrize("shape", ["triangle", "strip", "hole"])
def test_linear_displacements_are_exact_where_no_node_is_inside(shape: str) -> None:
    mesh = {"triangle": build_mesh(np.array([[0.0, 0.0], [9.0, 1.0], [2.0, 8.0]]), {T3: np.array([[0, 1, 2]])}),
            "strip": build_structured_mesh((0, 0, 80, 8), 8),
            "hole": build_structured_mesh((0, 0, 96, 96), 8, circles=[((50.0, 46.0), 21.0)])}[shape]
    h = np.array([[0.1, -0.2], [0.05, 0.3]])
    found = recover(mesh, mesh.nodes @ h.T)
    np.testing.assert_allclose(found, np.broadcast_to(h, found.shape), rtol=0, atol=1e-13)


def test_quadratic_displacements_are_exact_on_rectangles_up_to_the_edges() -> None:
    mesh = grid_mesh(6, 5, (8.0, 7.0), origin=(3.0, 4.0))
    x, y = mesh.nodes.T
    u = np.stack([1e-3 * x**2 + 2e-3 * x * y, 3e-3 * y**2 - 1e-3 * x * y], axis=1)
    expected = np.stack([np.stack([2e-3 * (x + y), 2e-3 * x], axis=1),
                         np.stack([-1e-3 * y, 6e-3 * y - 1e-3 * x], axis=1)], axis=1)
    # Cells hold the exact gradient in their middle alone: half a cell away it differs by 0.02.
    np.testing.assert_allclose(recover(mesh, u), expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("cells", ["Q4", "T3", "mixed"])
@pytest.mark.parametrize("jitter", [0.0, 0.2])
def test_a_wave_is_nearer_everywhere_than_by_cells(cells: Cells, jitter: float) -> None:
    points = np.random.default_rng(2).uniform(0.1 * SIDE, 0.9 * SIDE, (4000, 2))
    errors = []
    for n in (12, 24):
        mesh = grid_mesh(n, n, (SIDE / n, SIDE / n), cells=cells, jitter=jitter, seed=3)
        u, located = wave(mesh.nodes), locate(mesh, points)
        truth = gradient_of_wave(points).reshape(-1, 4)
        of_cells = compute_displacement_gradients(mesh, u.ravel())[located.cells].reshape(-1, 4)
        at_nodes = interpolate(mesh, recover(mesh, u).reshape(-1, 4), points)
        errors.append(rms(at_nodes - truth) / W)
        # Constants by cell err by half a cell times the slope; 0.5 leaves room for distorted cells.
        assert errors[-1] < 0.5 * rms(of_cells - truth) / W
    # Second order on even meshes, where constants by cell are of first order.
    assert np.log2(errors[0] / errors[1]) > (1.7 if jitter == 0 else 1.2)


@pytest.mark.parametrize("cells", ["Q4", "T3"])
def test_noise_of_nodes_is_damped(cells: Cells) -> None:
    mesh = grid_mesh(24, 24, (8.0, 8.0), cells=cells)
    noise = np.random.default_rng(1).normal(size=mesh.nodes.shape)
    of_cells = rms(compute_displacement_gradients(mesh, noise.ravel()))
    # Inside a grid, differences over two cells have 0.71 of the noise of those in the middle of one; edges have more.
    assert rms(recover(mesh, noise)) < 0.85 * of_cells


def test_sides_of_a_discontinuity_do_not_mix() -> None:
    whole = build_structured_mesh((0, 0, 96, 96), 8)
    mesh = cut_mesh(whole, [np.array([[-5.0, 30.0], [60.0, 53.0], [101.0, 71.0]])]).mesh
    h = np.array([[[0.1, -0.2], [0.05, 0.3]], [[-0.3, 0.1], [0.2, -0.1]]])
    below = mesh.centroids[:, 1] > np.interp(mesh.centroids[:, 0], [-5.0, 60.0, 101.0], [30.0, 53.0, 71.0])
    side = np.zeros(mesh.n_nodes, dtype=np.int64)
    for cell, is_below in zip(mesh.cells, below, strict=True):
        side[cell[cell >= 0]] = is_below
    u = np.einsum("ncj,nj->nc", h[side], mesh.nodes) + 10.0 * side[:, None]
    # A jump of 10 px over a cell of 8 would be a gradient of 1.
    np.testing.assert_allclose(recover(mesh, u), h[side], rtol=0, atol=1e-12)


@pytest.mark.parametrize("cells", ["Q4", "T3", "mixed"])
def test_cells_that_were_not_measured_spoil_none_beside_them(cells: Cells) -> None:
    mesh = grid_mesh(8, 7, (8.0, 8.0), cells=cells)
    h = np.array([[0.1, -0.2], [0.05, 0.3]])
    u = mesh.nodes @ h.T
    u[(np.abs(mesh.nodes - (24.0, 32.0)) <= 8.0).all(axis=1)] = np.nan
    whole = [cell[cell >= 0] for cell in mesh.cells if np.isfinite(u[cell[cell >= 0]]).all()]
    measured = np.unique(np.concatenate(whole))
    found = recover(mesh, u)
    np.testing.assert_allclose(found[measured], np.broadcast_to(h, (len(measured), 2, 2)), rtol=0, atol=1e-12)
    assert np.isnan(np.delete(found, measured, axis=0)).all()


def test_nothing_is_recovered_where_nothing_was_measured() -> None:
    mesh = grid_mesh(3, 3, (8.0, 8.0))
    assert np.isnan(recover(mesh, np.full(mesh.nodes.shape, np.nan))).all()
