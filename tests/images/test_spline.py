"""B-spline images: windows, exactness, gradient, bias."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage

from ddic.functionals.correlation import read_correlation
from ddic.images.binned import ArraySource
from ddic.images.spline import PADDING, compute_coefficients, read_gradient, read_spline
from ddic.images.sub_image import DeformedSubImage
from ddic.images.window import Window
from ddic.synth.fields import Translation
from support.pictures import pair_of, source
from support.random_meshes import grid_mesh

DEGREES = pytest.mark.parametrize("degree", [3, 5])
FLOAT32 = 6e-8
"""Relative rounding of one float32 number."""


def noise(height: int, width: int, seed: int = 0) -> NDArray[np.float64]:
    return np.random.default_rng(seed).integers(0, 256, (height, width)).astype(float)


def values_at_displaced_pixels(image: NDArray[np.float64], degree: int, low: int, high: int,
                               corners: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Kernel's values of an image at x + u(x) on the pixels of a square, NaN outside, and these points (n, 2).

    corners: displacement of the square's corners, (4, 2), pixels, bilinear in between.
    """
    mesh = grid_mesh(1, 1, (high - low, high - low), origin=(low, low))
    part = read_correlation(mesh, source(np.zeros_like(image)), degree)
    residual = part.compute_residual_image(DeformedSubImage(source(image), degree), corners.ravel())
    x, y = (a.ravel() for a in np.meshgrid(np.arange(low, high), np.arange(low, high)))
    s, t = (x - low) / (high - low), (y - low) / (high - low)
    shapes = np.stack([(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t], axis=1)
    window = part.reference.window
    return -residual[y - window.y0, x - window.x0].astype(float), np.column_stack([x, y]) + shapes @ corners


@DEGREES
@settings(max_examples=25)
@given(x0=st.integers(0, 180), y0=st.integers(0, 180), width=st.integers(16, 60), height=st.integers(16, 60))
def test_coefficients_of_a_window_equal_the_whole_images(degree: int, x0: int, y0: int, width: int,
                                                         height: int) -> None:
    image = noise(200, 210)
    window = Window((x0, y0), (x0 + width, y0 + height)).intersection(Window.of_size(210, 200))
    pad = PADDING[degree]
    found = read_spline(source(image).image, window, degree).coefficients
    whole = np.pad(compute_coefficients(image, degree), pad, mode="reflect")
    expected = whole[window.y0: window.y1 + 2 * pad, window.x0: window.x1 + 2 * pad]
    # Both are float64 to 1e-14 and then float32.
    np.testing.assert_allclose(found, expected, rtol=2 * FLOAT32, atol=1e-9)


@DEGREES
@settings(max_examples=25)
@given(x0=st.integers(0, 180), y0=st.integers(0, 180), width=st.integers(16, 60), height=st.integers(16, 60))
def test_gradient_of_a_window_equals_the_whole_images(degree: int, x0: int, y0: int, width: int,
                                                      height: int) -> None:
    image = noise(200, 210)
    window = Window((x0, y0), (x0 + width, y0 + height)).intersection(Window.of_size(210, 200))
    found = read_gradient(source(image).image, window, degree)
    whole = read_gradient(source(image).image, Window.of_size(210, 200), degree)
    part = np.s_[window.y0: window.y1, window.x0: window.x1]
    np.testing.assert_array_equal(found.values, image[part])
    np.testing.assert_allclose(found.slopes[0], whole.slopes[0][part], rtol=2 * FLOAT32, atol=1e-9)
    np.testing.assert_allclose(found.slopes[1], whole.slopes[1][part], rtol=2 * FLOAT32, atol=1e-9)


@DEGREES
def test_bands_of_a_tall_window_fit_together(degree: int) -> None:
    image = noise(1200, 20)
    whole = np.pad(compute_coefficients(image, degree), PADDING[degree], mode="reflect")
    spline = read_spline(source(image).image, Window.of_size(20, 1200), degree)
    np.testing.assert_allclose(spline.coefficients, whole, rtol=2 * FLOAT32, atol=1e-9)
    gradient = read_gradient(source(image).image, Window.of_size(20, 1200), degree)
    piece = read_gradient(source(image).image, Window((0, 480), (20, 540)), degree)
    np.testing.assert_allclose(gradient.slopes[1, 480:540], piece.slopes[1], rtol=2 * FLOAT32, atol=1e-9)


@DEGREES
def test_values_at_pixel_centres_are_the_images(degree: int) -> None:
    image = noise(60, 60)
    values, points = values_at_displaced_pixels(image, degree, 0, 50, np.tile([7.0, 9.0], (4, 1)))
    expected = image[np.rint(points[:, 1]).astype(int), np.rint(points[:, 0]).astype(int)]
    # Coefficients of white noise reach ten times the grey levels.
    np.testing.assert_allclose(values, expected, atol=2 * FLOAT32 * 2550)


@DEGREES
@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), reach=st.sampled_from([0.3, 3.0, 40.0]))
def test_values_equal_those_of_scipy(degree: int, seed: int, reach: float) -> None:
    image = noise(64, 64, seed)
    corners = np.random.default_rng(seed).uniform(-reach, reach, (4, 2))
    values, points = values_at_displaced_pixels(image, degree, 10, 54, corners)
    inside = ((points >= 0) & (points <= 63)).all(axis=1)
    expected = ndimage.map_coordinates(image, points[inside].T[::-1], order=degree, mode="mirror")
    np.testing.assert_allclose(values[inside], expected, atol=2 * FLOAT32 * 2550)
    # A point within rounding of the image's edge may count or not.
    assert np.isnan(values[((points < -1e-9) | (points > 63 + 1e-9)).any(axis=1)]).all()


@DEGREES
def test_polynomials_of_the_splines_degree_are_reproduced(degree: int) -> None:
    rng = np.random.default_rng(degree)
    coefficients = rng.uniform(-20, 20, (degree + 1, degree + 1))

    def polynomial(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.polynomial.polynomial.polyval2d((x - 80) / 80, (y - 80) / 80, coefficients))

    x, y = np.meshgrid(np.arange(161.0), np.arange(161.0))
    image = polynomial(x, y)
    corners = rng.uniform(-2, 2, (4, 2))
    # 58 px from the edge the reflection has decayed to 0.431^58 = 1e-21.
    values, points = values_at_displaced_pixels(image, degree, 60, 100, corners)
    scale = np.abs(image[55:106, 55:106]).max()
    np.testing.assert_allclose(values, polynomial(*points.T), atol=4 * FLOAT32 * scale)


@DEGREES
def test_gradient_equals_differences_of_the_spline(degree: int) -> None:
    image = noise(50, 60)
    gradient = read_gradient(source(image).image, Window.of_size(60, 50), degree)
    x, y = (a.ravel().astype(float) for a in np.meshgrid(np.arange(1, 59), np.arange(1, 49)))
    h = 1e-4
    for found, shift in zip(gradient.slopes, ((0.0, h), (h, 0.0)), strict=True):
        ahead, behind = (ndimage.map_coordinates(image, (y + s * shift[0], x + s * shift[1]), order=degree,
                                                 mode="mirror") for s in (1, -1))
        # h^2 / 6 times third derivatives of some thousand grey levels; float64 rounding over h: 1e-8.
        np.testing.assert_allclose(found[1:49, 1:59].ravel(), (ahead - behind) / (2 * h), atol=1e-4)


@DEGREES
def test_gradient_across_the_images_edge_is_zero(degree: int) -> None:
    gradient = read_gradient(source(noise(40, 40)).image, Window.of_size(40, 40), degree)
    # The image continues by reflection about its outermost pixels; sums of taps cancel in float64.
    by_x, by_y = gradient.slopes
    for edge in (by_x[:, 0], by_x[:, -1], by_y[0], by_y[-1]):
        np.testing.assert_allclose(edge, 0.0, atol=1e-9)


@pytest.mark.parametrize("degree", [3, 5])
def test_what_is_interpolated_from_an_excluded_pixel_is_left_out(degree: int) -> None:
    mask = np.ones((60, 60), dtype=bool)
    mask[25, 27] = False
    masked = source(noise(60, 60), mask)
    # A window that begins beside the pixel sees it all the same.
    for window in (Window.of_size(60, 60), Window((28, 10), (50, 50))):
        place = np.s_[window.y0: window.y1, window.x0: window.x1]
        # Values between two pixels are those of (degree + 1)^2 coefficients; a slope's lie on a cross.
        between = np.ones((60, 60), dtype=np.uint8)
        between[25 - degree // 2 - 1: 26 + degree // 2, 27 - degree // 2 - 1: 28 + degree // 2] = 0
        slopes = np.ones((60, 60), dtype=np.uint8)
        slopes[25 - degree // 2: 26 + degree // 2, 27] = slopes[25, 27 - degree // 2: 28 + degree // 2] = 0
        spline = read_spline(masked.image, window, degree, masked.find_usable)
        gradient = read_gradient(masked.image, window, degree, masked.find_usable)
        np.testing.assert_array_equal(spline.usable, between[place])
        np.testing.assert_array_equal(gradient.usable, slopes[place])


@pytest.mark.parametrize(("degree", "bound"), [(3, 1.5e-3), (5, 3.4e-4)])
@pytest.mark.parametrize("axis", [0, 1])
def test_bias_at_a_quarter_shift(degree: int, bound: float, axis: int) -> None:
    # On the reference texture 1.4e-3 px (cubic) and 2.3e-4 px (quintic) on average; pieces of this size scatter
    # between 1.3e-3 and 1.43e-3, and between 2.4e-4 and 3.2e-4.
    shift = 0.25 * np.eye(2)[axis]
    pair = pair_of(Translation((float(shift[0]), float(shift[1]))), 256)
    mesh = grid_mesh(1, 1, (216.0, 216.0), origin=(20.0, 20.0))
    part = read_correlation(mesh, source(pair.reference), degree)
    residual = part.compute_residual(DeformedSubImage(source(pair.deformed), degree), np.tile(shift, 4))
    rigid = np.tile(np.eye(2), (4, 1))
    hessian = rigid.T @ (part.assemble_hessian() @ rigid)
    bias = np.linalg.solve(hessian, rigid.T @ part.assemble_right_hand_side(residual))
    # Grey levels are not rounded here, so that a bias much below the table's would be a shift read wrongly.
    assert bound / 2 < bias[axis] < bound
    assert abs(bias[1 - axis]) < 5e-5


def test_what_is_excluded_from_an_image_adds_up() -> None:
    image = read_gradient(source(np.random.default_rng(4).uniform(size=(40, 50))).image, Window((3, 5), (33, 25)), 3)
    first, second = np.zeros((20, 30), dtype=bool), np.zeros((20, 30), dtype=bool)
    first[2, 3] = second[2, 3] = second[7, 8] = True
    once = image.exclude(first)
    twice = once.exclude(second)
    assert image.usable is None
    assert once.usable is not None
    assert twice.usable is not None
    np.testing.assert_array_equal(once.usable == 0, first)
    np.testing.assert_array_equal(twice.usable == 0, first | second)


@pytest.mark.parametrize(("dtype", "kept"), [(np.uint8, np.uint8), (np.uint16, np.float32), (np.float32, np.float32)])
def test_a_large_image_of_bytes_stays_bytes(monkeypatch: pytest.MonkeyPatch, dtype: type, kept: type) -> None:
    monkeypatch.setattr("ddic.images.spline.BYTES_FROM", 40 * 50)
    image = np.random.default_rng(4).integers(0, 256, (40, 50)).astype(dtype)
    found = read_gradient(ArraySource(Path("memory"), image), Window((3, 5), (33, 25)), 3)
    assert found.values.dtype == kept
    np.testing.assert_array_equal(found.values, image[5:25, 3:33])
    monkeypatch.setattr("ddic.images.spline.BYTES_FROM", 40 * 50 + 1)
    small = read_gradient(ArraySource(Path("memory"), image), Window((3, 5), (33, 25)), 3)
    assert small.values.dtype == np.float32
    np.testing.assert_array_equal(found.slopes, small.slopes)
