"""How much of the deformed image's noise reaches b, against noise that is interpolated pixel by pixel."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from ddic.functionals.correlation import read_correlation
from ddic.functionals.noise_transfer import (
    build_transfer,
    build_white_transfer,
    correlate_slopes,
    find_cell_transfer,
)
from ddic.functionals.view import View
from ddic.kinematics.nodal import NodalKinematics
from ddic.mesh.structured import build_structured_mesh
from support.pictures import source

SIDE = 96


def _view() -> View:
    rough = np.random.default_rng(3).standard_normal((SIDE + 24, SIDE + 24))
    grey = 100.0 + 60.0 * ndimage.gaussian_filter(rough, 0.8)
    mesh = build_structured_mesh((12, 12, SIDE + 12, SIDE + 12), 16)
    correlation = read_correlation(mesh, source(grey), 3)
    return View(correlation, NodalKinematics(mesh, np.arange(mesh.n_dofs)))


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.5, 0.0), (0.5, 0.5), (0.25, -0.4)])
def test_it_is_the_variance_of_forces(shift: tuple[float, float]) -> None:
    view = _view()
    table = build_transfer(correlate_slopes(view.correlation), 3)
    q = np.tile(shift, view.correlation.mesh.n_nodes)
    found = find_cell_transfer(table, view, q).mean(axis=0)
    reference = view.correlation.reference
    slopes = reference.slopes.astype(float)
    random, forces = np.random.default_rng(0), []
    for _ in range(1500):
        noise = random.standard_normal(reference.values.shape)
        moved = ndimage.shift(noise, (-shift[1], -shift[0]), order=3, mode="grid-wrap")
        # Signs by cells of 16 px, as shape functions tell cells apart.
        of_pixels = (slopes * moved)[:, :SIDE, :SIDE].reshape(2, SIDE // 16, 16, SIDE // 16, 16)
        forces.append(of_pixels.sum(axis=(2, 4)).reshape(2, -1))
    sums = (slopes**2)[:, :SIDE, :SIDE].reshape(2, SIDE // 16, 16, SIDE // 16, 16).sum(axis=(2, 4)).reshape(2, -1)
    measured = np.var(forces, axis=0).sum(axis=1) / sums.sum(axis=1)
    # 36 cells' variances from 1500 draws: 0.6 %; pixels at a cell's edge go together with others, 2 to 3 %.
    np.testing.assert_allclose(found, measured, rtol=0.04)


def test_a_coarse_texture_gains_less_than_a_single_value() -> None:
    view = _view()
    half = np.full(view.correlation.mesh.n_dofs, 0.5)
    white = find_cell_transfer(build_white_transfer(3, 2), view, half)
    # The cubic spline's sum of squares between two pixels is 0.756 (test_spline_noise), of four its square.
    np.testing.assert_allclose(white, 0.756**2, rtol=1e-3)
    of_texture = find_cell_transfer(build_transfer(correlate_slopes(view.correlation), 3), view, half)
    assert (of_texture > white + 0.1).all()


def test_an_image_without_texture_keeps_all_noise() -> None:
    nothing = np.zeros_like(correlate_slopes(_view().correlation))
    np.testing.assert_array_equal(build_transfer(nothing, 3).values, 1.0)
