"""The compiled sums over pixels against sums written out with numpy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ddic.functionals.correlation import Correlation, read_correlation
from ddic.functionals.pixel_kernels import BATCH
from ddic.images.sub_image import DeformedSubImage
from ddic.mesh.mesh import VTK_QUAD, Mesh
from support.pictures import source
from support.random_meshes import SEEDS, Cells, grid_mesh
from support.slow_correlation import SlowSums, cell_pixels, slow_sums

# Coefficients are stored in float32 (6e-8 of up to 10 times the grey levels on white noise).
GREY_ROUNDING = 1e-6
DEGREES = st.sampled_from([3, 5])


def noise(seed: int, height: int = 70, width: int = 80) -> NDArray[np.float64]:
    """White noise: the hardest image for the spline, every tap counts."""
    return np.random.default_rng(seed).integers(0, 256, (height, width)).astype(float)


def distorted(seed: int, cells: Cells) -> Mesh:
    return grid_mesh(3, 2, (11.0, 13.0), origin=(22.3, 16.6), cells=cells, seed=seed, jitter=0.2,
                     matrix=((0.9, -0.3), (0.4, 1.1)))


def assert_same(part: Correlation, deformed: DeformedSubImage, q: NDArray[np.float64], slow: SlowSums) -> None:
    fast = part.compute_residual(deformed, q, all_kinds=True)
    sums = fast.cell_sums.values
    np.testing.assert_array_equal(sums[:, 0], slow.grey[:, 0])
    # Each sum in units of what its n terms could be at most; 255 grey levels.
    n = np.maximum(slow.grey[:, :1], 1.0)
    units = n * np.array([1.0, 255.0, 255.0, 255.0**2, 255.0**2, 255.0**2])
    np.testing.assert_allclose(sums / units, slow.grey / units, atol=5 * GREY_ROUNDING)
    scale = 255.0 * sum(np.abs(c.gradient).sum() for c in cell_pixels(part))
    np.testing.assert_allclose(part.assemble_right_hand_side(fast) / scale, slow.b / scale, atol=GREY_ROUNDING)


@settings(max_examples=40)
@given(seed=SEEDS, cells=st.sampled_from(["Q4", "T3", "mixed"]), degree=DEGREES,
       reach=st.sampled_from([0.0, 2.0, 30.0]), f_masked=st.booleans(), g_masked=st.booleans())
def test_sums_equal_those_written_out(seed: int, cells: Cells, degree: int, reach: float, f_masked: bool,
                                      g_masked: bool) -> None:
    rng = np.random.default_rng(seed)
    mesh, f, g = distorted(seed, cells), noise(seed), noise(seed + 1)
    f_mask = rng.random(f.shape) < 0.7 if f_masked else None
    g_mask = rng.random(g.shape) < 0.9 if g_masked else None
    part = read_correlation(mesh, source(f, f_mask), degree)
    q = rng.uniform(-reach, reach, mesh.n_dofs)
    slow = slow_sums(part, g, degree, q, g_mask)
    assert_same(part, DeformedSubImage(source(g, g_mask), degree), q, slow)
    hessian = part.assemble_hessian().toarray()
    # float64 sums of the same float32 gradients: rounding of some hundred terms.
    np.testing.assert_allclose(hessian, slow.hessian, atol=1e-12 * np.abs(slow.hessian).max())


@pytest.mark.parametrize("degree", [3, 5])
def test_residual_image_equals_the_residual_written_out(degree: int) -> None:
    mesh, f, g = distorted(4, "mixed"), noise(1), noise(2)
    mask = np.random.default_rng(3).random(g.shape) < 0.9
    q = np.random.default_rng(4).uniform(-20, 20, mesh.n_dofs)
    part = read_correlation(mesh, source(f), degree)
    gain, offset = np.linspace(0.8, 1.2, mesh.n_cells), np.linspace(-5, 5, mesh.n_cells)
    image = part.compute_residual_image(DeformedSubImage(source(g, mask), degree), q, gain, offset)
    window = part.reference.window
    n_pixels = 0
    for e, (cell, r) in enumerate(zip(cell_pixels(part), slow_sums(part, g, degree, q, mask).residuals, strict=True)):
        expected = cell.f - gain[e] * (cell.f - r) - offset[e]
        found = image[cell.y - window.y0, cell.x - window.x0]
        np.testing.assert_allclose(found, expected, atol=255 * 10 * GREY_ROUNDING)
        n_pixels += int(np.isfinite(found).sum())
    assert 0 < n_pixels == np.isfinite(image).sum() < part.n_usable_pixels


@pytest.mark.parametrize("cells", ["Q4", "T3"])
def test_rows_longer_than_a_batch(cells: Cells) -> None:
    rng = np.random.default_rng(0)
    mesh = grid_mesh(1, 1, (2.5 * BATCH, 6.0), origin=(70.2, 3.4), cells=cells, seed=2, jitter=0.1)
    width = int(mesh.nodes[:, 0].max()) + 2
    f, g = noise(5, 14, width), noise(6, 14, width)
    part = read_correlation(mesh, source(f), 3)
    q = rng.uniform(-3, 3, mesh.n_dofs)
    slow = slow_sums(part, g, 3, q)
    assert_same(part, DeformedSubImage(source(g), 3), q, slow)
    np.testing.assert_allclose(part.assemble_hessian().toarray(), slow.hessian, atol=1e-12 * np.abs(slow.hessian).max())


def test_pixels_outside_the_deformed_image_are_left_out_and_counted() -> None:
    f = noise(0)
    mesh = grid_mesh(2, 1, (10.0, 8.0), origin=(20.0, 20.0))
    part = read_correlation(mesh, source(f), 3)
    q = np.tile([-25.5, 0.0], mesh.n_nodes)
    sums = part.compute_residual(DeformedSubImage(source(f), 3), q).cell_sums
    # Columns 20..25 are mapped to x < 0, of which the first cell (20..29) keeps four.
    assert sums.n_pixels.tolist() == [4 * 8, 10 * 8]


def test_last_pixel_of_the_image_counts() -> None:
    f = noise(0, 40, 50)
    mesh = grid_mesh(1, 1, (10.0, 10.0), origin=(40.0, 30.0))
    part = read_correlation(mesh, source(f), 5)
    residual = part.compute_residual(DeformedSubImage(source(f), 5), np.zeros(mesh.n_dofs))
    assert residual.sums.n_pixels == 100
    # All positions are pixel centres, where the spline equals the image but for float32 coefficients.
    np.testing.assert_allclose(residual.sums.values[3] / 100, 0.0, atol=(2550 * GREY_ROUNDING) ** 2)


@pytest.mark.parametrize("corner", [(52.0, 47.0), (44.0, 43.0), (38.6, 36.6)])
def test_local_coordinates_of_distorted_cells(corner: tuple[float, float]) -> None:
    """A quadrangle whose fourth corner approaches the diagonal: both ways to xi and eta, and the one near det J = 0."""
    x, y = corner
    mesh = Mesh(np.array([[20.2, 20.3], [53.1, 21.4], [x, y], [21.6, 52.3]]), np.arange(4), np.array([0, 4]),
                np.array([VTK_QUAD], dtype=np.uint8))
    part = read_correlation(mesh, source(noise(1)), 3)
    S = part.compute_cell_hessians()[0].reshape(4, 2, 4, 2)
    # Shapes sum to 1 and sum_a N_a x_a = x, whatever xi and eta: sums of x^2 over pixels need no inverse.
    (pixels,) = cell_pixels(part)
    products = np.einsum("pc,pd->pcd", pixels.gradient, pixels.gradient)
    for values, nodal in ((pixels.x, mesh.nodes[:, 0]), (pixels.y, mesh.nodes[:, 1])):
        found = np.einsum("a,acbd,b->cd", nodal, S, nodal)
        # Rounding of a thousand float64 terms.
        np.testing.assert_allclose(found, np.einsum("p,pcd->cd", values**2, products), rtol=1e-12, atol=1e-6)
