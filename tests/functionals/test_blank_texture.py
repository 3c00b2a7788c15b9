"""What counts as texture."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.functionals.correlation import read_correlation
from ddic.functionals.regularization import Material, integrate_cell_stiffness
from ddic.functionals.texture import Texture, find_blank_subdomains, measure_texture, rigid_modes
from ddic.kinematics.cell_interpolation import interpolate_cells
from support.cases import WAVES
from support.pictures import pair_of, source, square_mesh
from support.random_meshes import grid_mesh

SIDE = 192
Image = NDArray[np.float64]


def _of(image: Image, degree: int = 3, mask: NDArray[np.bool_] | None = None) -> Texture:
    """Texture of 4 x 4 cells of 16 px."""
    part = read_correlation(square_mesh(24, 88), source(image.astype(np.float32), mask), degree)
    return measure_texture(part, part.assemble_hessian(), degree)


def _speckle() -> Image:
    return pair_of(WAVES, SIDE, 8).reference.astype(float)


def _noise(sigma: float, seed: int = 0) -> Image:
    return np.round(128 + sigma * np.random.default_rng(seed).standard_normal((SIDE, SIDE)))


@pytest.mark.parametrize("degree", [3, 5])
def test_white_noise_is_recognised_as_such(degree: int) -> None:
    found = [_of(_noise(sigma, seed), degree) for sigma in (0.5, 2.0, 20.0) for seed in range(4)]
    translations = [t.energy / t.noise for t in found]
    # The rotation's nodes at the outline see fewer pixels, hence below 1; the estimate from 4096 px scatters by 5 %.
    assert min(translations) > 0.5
    assert max(translations) < 1.1


@pytest.mark.parametrize("degree", [3, 5])
def test_the_estimate_of_noise_is_that_of_the_gradient_of_noise(degree: int) -> None:
    image = source(_noise(20.0).astype(np.float32))
    part = read_correlation(square_mesh(24, 168), image, degree)
    translations = np.linalg.qr(rigid_modes(part.mesh.nodes))[0][:, :2]
    energy = np.trace(translations.T @ part.assemble_hessian() @ translations) / 2
    # Both are averages of 20 000 correlated squares.
    assert measure_texture(part, part.assemble_hessian(), degree).noise == pytest.approx(energy, rel=0.04)


def test_speckle_stands_out_of_strong_noise() -> None:
    noisy = _of(_speckle() + _noise(8.0) - 128.0)
    assert noisy.energy > 4 * noisy.noise


def test_what_varies_in_one_direction_only_holds_nothing() -> None:
    x = np.broadcast_to(np.arange(SIDE), (SIDE, SIDE))
    striped = _of(128 + 60 * np.sin(2 * np.pi * x / 7))
    # No translation along the stripes is seen but by float32's rounding of the slopes, 1e-7 of 50 per px.
    assert striped.energy < 1e-6 * _of(_speckle()).energy


def test_rings_do_not_hold_a_rotation() -> None:
    y, x = np.mgrid[:SIDE, :SIDE]
    rings = _of(128 + 60 * np.cos(2 * np.pi * np.hypot(x - 56.0, y - 56.0) / 9))
    # Translations are held; what is left of the rotation about the centre is the spline's slope across the rings.
    assert rings.energy < 1e-4 * _of(_speckle()).energy


def test_masked_pixels_hold_nothing() -> None:
    mask = np.zeros((SIDE, SIDE), dtype=bool)
    assert _of(_speckle(), mask=mask).energy == 0.0
    mask[100:, 100:] = True
    assert _of(_speckle(), mask=mask).energy == 0.0  # not a pixel of this mesh
    mask[:122, :122] = True
    # All pixels of the mesh and as many about it as the prefilter reaches (sums in another order).
    assert _of(_speckle(), mask=mask).energy == pytest.approx(_of(_speckle()).energy, rel=1e-12)


def test_a_mask_beside_the_pixels_changes_no_noise() -> None:
    mask = np.zeros((SIDE, SIDE), dtype=bool)
    mask[:122, :122] = True
    assert _of(_speckle(), mask=mask).noise == pytest.approx(_of(_speckle()).noise, rel=1e-12)


def test_masked_pixels_bring_no_noise_to_their_neighbours() -> None:
    mask = np.ones((SIDE, SIDE), dtype=bool)
    mask[40:60, 40:60] = False
    image, spoilt = _speckle(), _speckle()
    spoilt[~mask] = 255.0
    spoilt[45:55, 45:55] = 0.0
    assert _of(spoilt, mask=mask).noise == pytest.approx(_of(image, mask=mask).noise, rel=1e-12)


def test_rigid_modes_are_all_that_stiffness_does_not_see() -> None:
    mesh = grid_mesh(4, 3, (7.0, 5.0), origin=(100.0, 40.0), cells="mixed", seed=2, jitter=0.2)
    stiffness = interpolate_cells(mesh).assemble_matrix(integrate_cell_stiffness(mesh, Material()))
    modes = rigid_modes(mesh.nodes)
    assert np.linalg.matrix_rank(modes) == 3
    # Entries of K are of order 1, those of the rotation of order 10: rounding.
    assert np.abs(stiffness @ modes).max() < 1e-12


def _flags(*pairs: tuple[float, float]) -> list[bool]:
    return [bool(flag) for flag in find_blank_subdomains([Texture(*pair) for pair in pairs])]


def test_blank_subdomains() -> None:
    # Nothing, and noise only, beside texture.
    assert _flags((1e5, 1e3), (0.0, 0.0), (600.0, 900.0), (9e4, 1e3)) == [False, True, True, False]
    # Most of the region is blank.
    assert _flags((600.0, 900.0), (0.0, 0.0), (600.0, 900.0), (0.0, 0.0), (9e4, 1e3)) == [True] * 4 + [False]
    # Weak texture that stands out of the noise is texture.
    assert _flags((1e5, 100.0), (600.0, 100.0)) == [False, False]
    # Grains of a pixel look like noise; beside others as strong they are not taken for it.
    assert _flags((1e5, 1e3), (2e5, 1.5e5)) == [False, False]
    # All the same: noise everywhere, or nothing anywhere.
    assert _flags((600.0, 900.0), (700.0, 900.0)) == [False, False]
    assert _flags((0.0, 0.0), (0.0, 0.0)) == [True, True]
