"""M, b and grey statistics of a region: sums over subdomains, derivative, grey corrections."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ddic.functionals.correlation import Residual, read_correlation
from ddic.functionals.grey_statistics import GreySums
from ddic.images.sub_image import DeformedSubImage, MaskedSource
from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import rasterize
from support.pictures import source
from support.random_meshes import (
    PARTITIONS,
    SEEDS,
    delaunay_meshes,
    grid_mesh,
    grid_meshes,
    lattice_meshes,
    random_partition,
)

# Spline coefficients of different windows are the same float64 numbers to some 1e-14 and may round to
# neighbouring float32 numbers (6e-8); a few of them among hundreds of pixels move the sums by 1e-10.
# One pixel too few or too many moves them by 1e-4.
SUM_ROUNDING = 1e-9

MARGIN = 12
Correction = Literal["none", "global", "element"]


def onto_image(mesh: Mesh) -> tuple[Mesh, int, int]:
    """The mesh moved to whole pixels inside an image, and that image's width and height."""
    nodes = mesh.nodes - np.floor(mesh.nodes.min(axis=0)) + MARGIN
    width, height = (np.ceil(nodes.max(axis=0)) + MARGIN).astype(int)
    return Mesh(nodes, mesh.connectivity, mesh.offsets, mesh.types), int(width), int(height)


def random_source(rng: np.random.Generator, width: int, height: int, masked: bool) -> MaskedSource:
    values = rng.integers(0, 256, (height, width)).astype(float)
    return source(values, rng.random((height, width)) < 0.85 if masked else None, exclude_saturated=masked)


def b_of(residuals: list[Residual], one: Residual, correction: Correction,
         ) -> tuple[NDArray[np.float64] | float, NDArray[np.float64] | float]:
    """Gain and offset of one subdomain, where "global" comes from the sums of all."""
    if correction == "none":
        return 1.0, 0.0
    if correction == "element":
        return one.cell_sums.fit_gain_and_offset()
    return GreySums(np.sum([r.sums.values for r in residuals], axis=0)).fit_gain_and_offset()


@settings(max_examples=150)
@given(mesh=st.one_of(grid_meshes(most=4), delaunay_meshes(), lattice_meshes()), kind=PARTITIONS,
       n=st.integers(1, 6), degree=st.sampled_from([3, 5]), masked=st.booleans(),
       reach=st.sampled_from([0.0, 1.5, 25.0]), correction=st.sampled_from(["none", "global", "element"]), seed=SEEDS)
def test_subdomains_add_up_to_the_whole(mesh: Mesh, kind: str, n: int, degree: int, masked: bool, reach: float,
                                        correction: Correction, seed: int) -> None:
    mesh, width, height = onto_image(mesh)
    if not rasterize(mesh).pixel_counts.any():
        return
    rng = np.random.default_rng(seed)
    f, g = random_source(rng, width, height, masked), random_source(rng, width, height, masked)
    q = rng.uniform(-reach, reach, mesh.n_dofs)
    cells = random_partition(mesh, kind, n, seed)
    whole = read_correlation(mesh, f, degree)
    whole_residual = whole.compute_residual(DeformedSubImage(g, degree), q, all_kinds=True)
    parts, residuals, dofs = [], [], []
    for s in range(int(cells.max()) + 1):
        part_mesh, node_ids = mesh.create_submesh(np.flatnonzero(cells == s))
        if not rasterize(part_mesh).pixel_counts.any():
            continue
        dofs.append((2 * node_ids[:, None] + np.arange(2)).ravel())
        parts.append(read_correlation(part_mesh, f, degree))
        residuals.append(parts[-1].compute_residual(DeformedSubImage(g, degree), q[dofs[-1]], all_kinds=True))
    hessian, b = np.zeros((len(q), len(q))), np.zeros(len(q))
    for part, residual, d in zip(parts, residuals, dofs, strict=True):
        hessian[np.ix_(d, d)] += part.assemble_hessian().toarray()
        b[d] += part.assemble_right_hand_side(residual, *b_of(residuals, residual, correction))
    expected = whole.assemble_hessian().toarray()
    np.testing.assert_allclose(hessian, expected, atol=SUM_ROUNDING * max(np.abs(expected).max(), 1.0))
    whole_b = whole.assemble_right_hand_side(whole_residual, *b_of([whole_residual], whole_residual, correction))
    # Moments are of order grey x gradient; those of a pixel whose spline or gain is rounded scale with them.
    scale = max(np.abs(whole_residual.moments).max(), 1.0)
    np.testing.assert_allclose(b / scale, whole_b / scale, atol=SUM_ROUNDING)
    assert sum(float(r.sums.n_pixels) for r in residuals) == float(whole_residual.sums.n_pixels)
    assert sum(part.n_usable_pixels for part in parts) == whole.n_usable_pixels


def smooth_picture(side: int) -> NDArray[np.float64]:
    x, y = np.meshgrid(np.arange(side), np.arange(side))
    return np.asarray(120 + 60 * np.sin(x / 7.0) * np.cos(y / 9.0) + 30 * np.sin((x + 2 * y) / 11.0))


@pytest.mark.parametrize("degree", [3, 5])
@pytest.mark.parametrize("cells", ["Q4", "T3"])
def test_derivative_of_b_is_minus_m_where_images_agree(cells: Literal["Q4", "T3"], degree: int) -> None:
    image = source(smooth_picture(100))
    mesh = grid_mesh(4, 4, (15.0, 15.0), origin=(20.3, 19.6), cells=cells, seed=1, jitter=0.2)
    part = read_correlation(mesh, image, degree)
    v = np.random.default_rng(2).uniform(-1, 1, mesh.n_dofs)

    def b(t: float) -> NDArray[np.float64]:
        return part.assemble_right_hand_side(part.compute_residual(DeformedSubImage(image, degree), t * v))

    step = 0.02
    expected = part.assemble_hessian() @ v
    # The central difference errs by step^2 / 6 times the picture's third derivative over its first, 1/7^2: 1e-6;
    # grey levels are rounded by 1e-5, which against differences of 10 step leaves 1e-4 at most, less in sums.
    np.testing.assert_allclose((b(-step) - b(step)) / (2 * step), expected, atol=3e-5 * np.abs(expected).max())


def test_b_vanishes_for_identical_images() -> None:
    image = source(smooth_picture(80))
    mesh = grid_mesh(3, 3, (15.0, 15.0), origin=(15.0, 15.0))
    part = read_correlation(mesh, image, 3)
    q = np.zeros(mesh.n_dofs)
    residual = part.compute_residual(DeformedSubImage(image, 3), q)
    # Positions are pixel centres, where the spline equals f but for rounding of its float32 coefficients.
    assert np.sqrt(residual.sums.values[3] / residual.sums.n_pixels) < 2e-5
    dq = np.linalg.solve(part.assemble_hessian().toarray(), part.assemble_right_hand_side(residual))
    assert np.abs(dq).max() < 1e-5


def test_hessian_is_symmetric_and_positive() -> None:
    mesh = grid_mesh(3, 3, (15.0, 15.0), origin=(15.2, 15.1), cells="mixed", seed=3, jitter=0.2)
    hessian = read_correlation(mesh, source(smooth_picture(80)), 3).assemble_hessian().toarray()
    np.testing.assert_allclose(hessian, hessian.T, atol=1e-14 * np.abs(hessian).max())
    # Both gradient directions vary within every node's support, so no displacement goes unseen.
    assert np.linalg.eigvalsh(hessian)[0] > 1e-4 * np.diag(hessian).mean()


def grey_sums(f: NDArray[np.float64], g: NDArray[np.float64]) -> GreySums:
    r = f - g
    return GreySums(np.array([len(f), r.sum(), g.sum(), (r**2).sum(), (g**2).sum(), (r * g).sum()]))


@given(seed=SEEDS, n=st.integers(5, 200), gain=st.floats(0.2, 3), offset=st.floats(-80, 80))
def test_gain_and_offset_are_the_least_squares_fit(seed: int, n: int, gain: float, offset: float) -> None:
    rng = np.random.default_rng(seed)
    g = rng.uniform(0, 255, n)
    f = gain * g + offset + rng.normal(0, 3, n)
    found_gain, found_offset = grey_sums(f, g).fit_gain_and_offset()
    slope, intercept = np.polyfit(g, f, 1)
    # Sums of squares of 255 lose some four digits to the variance; five pixels may lie close together.
    np.testing.assert_allclose([found_gain, found_offset], [slope, intercept], rtol=1e-7, atol=1e-7)
    first, second = grey_sums(f, g).sum_residual(found_gain, found_offset)
    exact = f - slope * g - intercept
    # The sums cancel from n 255^2 down to n 3^2 grey levels squared.
    np.testing.assert_allclose([first, second], [exact.sum(), (exact**2).sum()], rtol=1e-6, atol=1e-6)


def test_flat_and_empty_regions_have_no_gain() -> None:
    flat = np.full(50, 100.0)
    gain, offset = grey_sums(flat + 7.0, flat).fit_gain_and_offset()
    assert (float(gain), float(offset)) == (1.0, pytest.approx(7.0, abs=1e-12))
    gain, offset = GreySums(np.zeros((3, 6))).fit_gain_and_offset()
    assert gain.tolist() == [1.0] * 3
    assert offset.tolist() == [0.0] * 3


@pytest.mark.parametrize("correction", ["global", "element"])
def test_correction_takes_out_brightness_and_contrast(correction: Correction) -> None:
    f = smooth_picture(90)
    g = (f - 12.0) / 1.3
    mesh = grid_mesh(3, 3, (15.0, 15.0), origin=(20.0, 20.0), cells="mixed", seed=1)
    part = read_correlation(mesh, source(f), 3)
    residual = part.compute_residual(DeformedSubImage(source(g), 3), np.zeros(mesh.n_dofs), all_kinds=True)
    gain, offset = b_of([residual], residual, correction)
    # float32 grey levels and coefficients, 6e-8 of 200.
    np.testing.assert_allclose(gain, 1.3, atol=1e-5)
    np.testing.assert_allclose(offset, 12.0, atol=1e-3)
    b = part.assemble_right_hand_side(residual, gain, offset)
    plain = part.assemble_right_hand_side(residual)
    assert np.abs(b).max() < 1e-6 * np.abs(plain).max()
    image = part.compute_residual_image(DeformedSubImage(source(g), 3), np.zeros(mesh.n_dofs), gain, offset)
    assert np.nanmax(np.abs(image)) < 2e-3


def test_masked_and_saturated_pixels_of_f_are_left_out() -> None:
    f = smooth_picture(60)
    f[22, 25] = 255.0
    mask = np.ones(f.shape, dtype=bool)
    mask[30:33, 30:40] = False
    mesh = grid_mesh(2, 2, (12.0, 12.0), origin=(20.0, 20.0))
    part = read_correlation(mesh, source(f, mask, exclude_saturated=True), 3)
    residual = part.compute_residual(DeformedSubImage(source(f), 3), np.zeros(mesh.n_dofs))
    # And those beside them, whose slopes are taken from them.
    left_out = 3 * 10 + 2 * 10 + 2 * 3 + 1 + 4
    assert part.n_usable_pixels == residual.sums.n_pixels == 24 * 24 - left_out


def test_pixels_hidden_in_the_deformed_image_leave_m_too() -> None:
    rng = np.random.default_rng(3)
    mesh, width, height = onto_image(grid_mesh(4, 3, (9.0, 9.0), cells="Q4", seed=2, jitter=0.2))
    f, g = random_source(rng, width, height, masked=False), random_source(rng, width, height, masked=False)
    one, deformed = read_correlation(mesh, f, 3), DeformedSubImage(g, 3)
    still = np.zeros(mesh.n_dofs)
    assert one.without_hidden(deformed, still) is one
    assert one.compute_residual(deformed, still).n_pixels == one.n_usable_pixels
    # Moved left by the margin and two cells' width, what lay within that distance of the edge is out of sight.
    moved = np.tile([-(MARGIN + 18.0), 0.0], mesh.n_nodes)
    seen = one.without_hidden(deformed, moved)
    counted = one.compute_residual(deformed, moved).sums.n_pixels
    assert 0 < seen.n_usable_pixels == counted < one.n_usable_pixels
    assert seen.compute_residual(deformed, moved).sums.n_pixels == counted
    hidden = seen.raster.sum_by_cell(seen.reference.usable, seen.reference.window) == 0
    assert hidden.any()
    assert (seen.compute_cell_hessians()[hidden] == 0).all()
    assert (one.compute_cell_hessians()[hidden] != 0).any()


def test_no_correction_is_the_limit_of_small_ones() -> None:
    mesh, width, height = onto_image(grid_mesh(3, 3, (9.0, 9.0)))
    rng = np.random.default_rng(4)
    correlation = read_correlation(mesh, random_source(rng, width, height, False), 3)
    deformed = DeformedSubImage(random_source(rng, width, height, False), 3)
    residual = correlation.compute_residual(deformed, np.zeros(mesh.n_dofs), all_kinds=True)
    b = correlation.assemble_right_hand_side(residual)
    ones = np.ones(mesh.n_cells)
    # The same sums: nothing is multiplied by an excess of 0.
    np.testing.assert_array_equal(correlation.assemble_right_hand_side(residual, ones, 0 * ones), b)
    small = 1e-9
    near = correlation.assemble_right_hand_side(residual, 1 + small * ones, small * ones)
    # g and 1 against grad f are as large as r against it, but for a factor of a few hundred grey levels.
    np.testing.assert_allclose(near, b, atol=1e3 * small * np.abs(b).max())
    assert not np.array_equal(near, b)
