"""The readable kernels against the mesh's shape functions and scipy's splines."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage
from scipy.interpolate import BSpline

from ddic.functionals.correlation import Correlation, read_correlation
from ddic.images.source import fill_excluded
from ddic.images.sub_image import DeformedSubImage
from support.pictures import source
from support.random_meshes import grid_mesh
from support.readable_kernels import evaluate_b_spline, find_local_coordinates, monomials
from support.slow_correlation import CellPixels, cell_pixels, readable_kernels_instead

HEIGHT, WIDTH = 60, 70
# Coefficients are stored in float32 (6e-8 of up to 10 times the grey levels on white noise).
GREY_ROUNDING = 255 * 1e-6


def noise(seed: int) -> NDArray[np.float64]:
    return np.random.default_rng(seed).integers(0, 256, (HEIGHT, WIDTH)).astype(float)


def a_part(seed: int, degree: int, mask: NDArray[np.bool_] | None = None) -> Correlation:
    mesh = grid_mesh(2, 2, (11.0, 12.0), origin=(20.3, 15.6), cells="mixed", seed=seed, jitter=0.2,
                     matrix=((0.9, -0.3), (0.4, 1.1)))
    return read_correlation(mesh, source(noise(seed), mask), degree)


def rows_of(cell: CellPixels) -> NDArray[np.float64]:
    """Rows of N^T grad f, (n_pixels, n_dofs of the cell)."""
    return (cell.shapes[:, :, None] * cell.gradient[:, None, :]).reshape(len(cell.x), -1)


def dofs_of(cell: CellPixels) -> NDArray[np.int64]:
    return np.asarray((2 * cell.nodes[:, None] + np.arange(2)).ravel())


def counts_of(part: Correlation, cell: CellPixels) -> NDArray[np.bool_]:
    f = part.reference
    if f.usable is None:
        return np.ones(len(cell.x), dtype=bool)
    return np.asarray(f.usable[cell.y - f.window.y0, cell.x - f.window.x0] > 0)


def test_m_is_that_of_the_shape_functions() -> None:
    part = a_part(1, 3, np.random.default_rng(1).random((HEIGHT, WIDTH)) < 0.8)
    with readable_kernels_instead():
        found = part.assemble_hessian().toarray()
    expected = np.zeros_like(found)
    for cell in cell_pixels(part):
        rows = rows_of(cell)[counts_of(part, cell)]
        expected[np.ix_(dofs_of(cell), dofs_of(cell))] += rows.T @ rows
    np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("degree", [3, 5])
def test_b_and_the_residual_are_those_of_scipys_spline(degree: int, masked: bool) -> None:
    g = noise(7)
    mask = np.random.default_rng(2).random(g.shape) < 0.99
    part = a_part(3, degree, mask if masked else None)
    deformed = DeformedSubImage(source(g, mask if masked else None), degree)
    filled = fill_excluded(g, mask.astype(np.uint8)) if masked else g
    # Some pixels leave the image.
    q = np.random.default_rng(4).uniform(-20, 20, part.mesh.n_dofs)
    with readable_kernels_instead():
        residual = part.compute_residual(deformed, q, all_kinds=True)
        image = part.compute_residual_image(deformed, q)
    b, scale, n_pixels = np.zeros(len(q)), 0.0, 0
    for e, cell in enumerate(cell_pixels(part)):
        px, py = (np.stack([cell.x, cell.y], axis=1) + cell.shapes @ q.reshape(-1, 2)[cell.nodes]).T
        counts = counts_of(part, cell) & (px >= 0) & (px <= WIDTH - 1) & (py >= 0) & (py <= HEIGHT - 1)
        if masked:
            corners = np.clip(np.floor(np.stack([py, px], axis=1)), 0, [HEIGHT - 1, WIDTH - 1]).astype(int)
            low, high = np.maximum(corners - degree // 2, 0), corners + degree // 2 + 2
            seen = [mask[i0: i1, j0: j1].all() for (i0, j0), (i1, j1) in zip(low, high, strict=True)]
            counts &= np.array(seen, dtype=bool)
        moved = ndimage.map_coordinates(filled, [py, px], order=degree, mode="mirror")
        r = np.where(counts, cell.f - moved, np.nan)
        found = image[cell.y - part.reference.window.y0, cell.x - part.reference.window.x0]
        np.testing.assert_allclose(found, r, atol=10 * GREY_ROUNDING)
        b[dofs_of(cell)] += rows_of(cell)[counts].T @ r[counts]
        scale = max(scale, np.abs(rows_of(cell)).sum())
        r, moved = r[counts], moved[counts]
        sums = [len(r), r.sum(), moved.sum(), (r**2).sum(), (moved**2).sum(), (r * moved).sum()]
        np.testing.assert_allclose(residual.cell_sums.values[e], sums, rtol=1e-6, atol=len(r) * 255 * GREY_ROUNDING)
        n_pixels += len(r)
    np.testing.assert_allclose(part.assemble_right_hand_side(residual), b, atol=scale * GREY_ROUNDING)
    assert 0 < residual.n_pixels == n_pixels < part.n_usable_pixels


@pytest.mark.parametrize("degree", [3, 5])
def test_b_splines_are_scipys(degree: int) -> None:
    t = np.linspace(-4, 4, 33)
    one = BSpline.basis_element(np.arange(degree + 2) - (degree + 1) / 2, extrapolate=False)
    np.testing.assert_allclose([evaluate_b_spline(s, degree) for s in t], np.nan_to_num(one(t)), atol=1e-15)


def test_local_coordinates_are_those_of_the_position() -> None:
    geometry = np.array([[30.0, 7.0, 1.5, 0.8], [20.0, -1.0, 6.0, -0.5]])
    for xi, eta in np.random.default_rng(0).uniform(-1, 1, (20, 2)):
        place = geometry @ monomials(np.array([xi, eta]), 4)
        np.testing.assert_allclose(find_local_coordinates(geometry, place), (xi, eta), atol=1e-14)
