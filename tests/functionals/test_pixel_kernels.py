"""The compiled sums over pixels against the readable ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ddic.functionals.correlation import Correlation, read_correlation
from ddic.functionals.pixel_kernels import BATCH
from ddic.images.sub_image import DeformedSubImage
from ddic.mesh.cell_type import Q4
from ddic.mesh.mesh import Mesh
from support.pictures import source
from support.random_meshes import SEEDS, Cells, grid_mesh
from support.slow_correlation import cell_pixels, readable_kernels_instead

# Both sum float64 products of the same float32 numbers: rounding of some hundred to thousand terms.
SUM_ROUNDING = 1e-12
# A residual image is float32, 6e-8 of up to 10 times the grey levels on white noise.
GREY_ROUNDING = 1e-6
DEGREES = st.sampled_from([3, 5])


def noise(seed: int, height: int = 70, width: int = 80) -> NDArray[np.float64]:
    """White noise: the hardest image for the spline, every tap counts."""
    return np.random.default_rng(seed).integers(0, 256, (height, width)).astype(float)


def distorted(seed: int, cells: Cells) -> Mesh:
    return grid_mesh(3, 2, (11.0, 13.0), origin=(22.3, 16.6), cells=cells, seed=seed, jitter=0.2,
                     matrix=((0.9, -0.3), (0.4, 1.1)))


def assert_same_sums(part: Correlation, deformed: DeformedSubImage, q: NDArray[np.float64]) -> None:
    fast, hessians = part.compute_residual(deformed, q, all_kinds=True), part.compute_cell_hessians()
    with readable_kernels_instead():
        anew = replace(part)
        slow, expected = anew.compute_residual(deformed, q, all_kinds=True), anew.compute_cell_hessians()
    np.testing.assert_array_equal(fast.cell_sums.n_pixels, slow.cell_sums.n_pixels)
    # Each sum in units of what its n terms could be at most; 255 grey levels, which the spline exceeds by ten times.
    n = np.maximum(slow.cell_sums.n_pixels, 1.0)
    grey = 255.0 * np.array([[0.0, 1.0, 1.0, 255.0, 255.0, 255.0]]) + 1.0
    units = n[:, None] * grey
    np.testing.assert_allclose(fast.cell_sums.values / units, slow.cell_sums.values / units, atol=10 * SUM_ROUNDING)
    steepest = np.abs(part.reference.slopes).max()
    scale = 255.0 * steepest * n[:, None, None, None]
    np.testing.assert_allclose(fast.moments / scale, slow.moments / scale, atol=10 * SUM_ROUNDING)
    np.testing.assert_allclose(hessians, expected, atol=SUM_ROUNDING * np.abs(expected).max())


@settings(max_examples=12)
@given(seed=SEEDS, cells=st.sampled_from(["Q4", "T3", "mixed"]), degree=DEGREES,
       reach=st.sampled_from([0.0, 2.0, 30.0]), f_masked=st.booleans(), g_masked=st.booleans())
def test_sums_equal_the_readable_ones(seed: int, cells: Cells, degree: int, reach: float, f_masked: bool,
                                      g_masked: bool) -> None:
    rng = np.random.default_rng(seed)
    mesh, f, g = distorted(seed, cells), noise(seed), noise(seed + 1)
    f_mask = rng.random(f.shape) < 0.7 if f_masked else None
    g_mask = rng.random(g.shape) < 0.9 if g_masked else None
    part = read_correlation(mesh, source(f, f_mask), degree)
    q = rng.uniform(-reach, reach, mesh.n_dofs)
    assert_same_sums(part, DeformedSubImage(source(g, g_mask), degree), q)


@pytest.mark.parametrize("degree", [3, 5])
def test_residual_image_equals_the_readable_one(degree: int) -> None:
    mesh, f, g = distorted(4, "mixed"), noise(1), noise(2)
    mask = np.random.default_rng(3).random(g.shape) < 0.9
    q = np.random.default_rng(4).uniform(-20, 20, mesh.n_dofs)
    part, deformed = read_correlation(mesh, source(f), degree), DeformedSubImage(source(g, mask), degree)
    gain, offset = np.linspace(0.8, 1.2, mesh.n_cells), np.linspace(-5, 5, mesh.n_cells)
    found = part.compute_residual_image(deformed, q, gain, offset)
    with readable_kernels_instead():
        expected = part.compute_residual_image(deformed, q, gain, offset)
    np.testing.assert_allclose(found, expected, atol=255 * 10 * GREY_ROUNDING)
    assert 0 < np.isfinite(found).sum() < part.n_usable_pixels


def test_an_image_of_bytes_gives_the_same_bits() -> None:
    f, g = noise(1), noise(2)
    # The last cell ends at the image's last pixel, beyond which no vector may be read.
    mesh = grid_mesh(6, 5, (13.0, 13.0), origin=(2.0, 5.0), cells="mixed", seed=4, jitter=0.0)
    q = np.random.default_rng(4).uniform(-20, 20, mesh.n_dofs)
    deformed = DeformedSubImage(source(g), 3)
    of_floats = read_correlation(mesh, source(f), 3)
    reference = of_floats.reference
    assert reference.window.upper == f.shape[::-1]
    of_bytes = replace(of_floats, reference=replace(reference, values=reference.values.astype(np.uint8)))
    found, expected = (part.compute_residual(deformed, q, all_kinds=True) for part in (of_bytes, of_floats))
    np.testing.assert_array_equal(found.moments, expected.moments)
    np.testing.assert_array_equal(found.cell_sums.values, expected.cell_sums.values)
    np.testing.assert_array_equal(of_bytes.compute_cell_hessians(), of_floats.compute_cell_hessians())
    np.testing.assert_array_equal(*(part.compute_residual_image(deformed, q) for part in (of_bytes, of_floats)))


@pytest.mark.parametrize("cells", ["Q4", "T3"])
def test_rows_longer_than_a_batch(cells: Cells) -> None:
    rng = np.random.default_rng(0)
    mesh = grid_mesh(1, 1, (2.5 * BATCH, 4.0), origin=(70.2, 3.4), cells=cells, seed=2, jitter=0.1)
    width = int(mesh.nodes[:, 0].max()) + 2
    f, g = noise(5, 14, width), noise(6, 14, width)
    part = read_correlation(mesh, source(f), 3)
    assert_same_sums(part, DeformedSubImage(source(g), 3), rng.uniform(-3, 3, mesh.n_dofs))


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
                np.array([Q4.vtk], dtype=np.uint8))
    part = read_correlation(mesh, source(noise(1)), 3)
    S = part.compute_cell_hessians()[0].reshape(4, 2, 4, 2)
    # Shapes sum to 1 and sum_a N_a x_a = x, whatever xi and eta: sums of x^2 over pixels need no inverse.
    (pixels,) = cell_pixels(part)
    products = np.einsum("pc,pd->pcd", pixels.gradient, pixels.gradient)
    for values, nodal in ((pixels.x, mesh.nodes[:, 0]), (pixels.y, mesh.nodes[:, 1])):
        found = np.einsum("a,acbd,b->cd", nodal, S, nodal)
        # Rounding of a thousand float64 terms.
        np.testing.assert_allclose(found, np.einsum("p,pcd->cd", values**2, products), rtol=1e-12, atol=1e-6)


@pytest.mark.parametrize("height", [1, 14, 20])
@pytest.mark.parametrize("f_masked", [False, True])
def test_bands_of_the_residual_image_are_the_image(height: int, f_masked: bool) -> None:
    mesh, f, g = distorted(4, "mixed"), noise(1), noise(2)
    rng = np.random.default_rng(3)
    f_mask = rng.random(f.shape) < 0.7 if f_masked else None
    part = read_correlation(mesh, source(f, f_mask), 3)
    deformed = DeformedSubImage(source(g, rng.random(g.shape) < 0.9), 3)
    q = rng.uniform(-20, 20, mesh.n_dofs)
    # One cell is torn.
    q[0] += 1e3
    correction = np.linspace(0.8, 1.2, mesh.n_cells), np.linspace(-5, 5, mesh.n_cells)
    bands = part.split_bands(height)
    assert len(bands) > 1
    assert np.sort(np.concatenate([band.order for band in bands])).tolist() == list(range(mesh.n_cells))
    found = np.full(part.reference.values.shape, np.nan, np.float32)
    for band, image in zip(bands, part.compute_residual_bands(deformed, q, bands, *correction), strict=True):
        np.copyto(found[part.reference.window.locate(band.window)], image, where=np.isfinite(image))
    np.testing.assert_array_equal(found, part.compute_residual_image(deformed, q, *correction))


def test_bands_are_as_high_as_the_tallest_cell_at_least() -> None:
    mesh = grid_mesh(3, 4, (10.0, 40.0), origin=(20.0, 20.0), seed=2, jitter=0.0)
    bands = read_correlation(mesh, source(noise(1, 240, 80)), 3).split_bands(8)
    assert [len(band.order) for band in bands] == [3, 3, 3, 3]
    assert all(band.window.height == 40 for band in bands)
