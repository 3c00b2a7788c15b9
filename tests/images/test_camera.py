"""Camera mappings."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ddic.images.camera import CameraMapping, identity, similarity

TILTED = np.array([[4.9, -0.3, -1800.0], [0.4, 5.1, -900.0], [2e-5, -1.5e-5, 1.0]])
PLAIN = CameraMapping(TILTED)
PINCUSHION = CameraMapping(TILTED, np.array([695.5, 519.5]), 868.0, np.array([0.02, 0.003]))
BARREL = CameraMapping(TILTED, np.array([700.0, 510.0]), 868.0, np.array([-0.03, 0.004]))
MAPPINGS = [PLAIN, PINCUSHION, BARREL]

coordinates = st.floats(-1e4, 1e4)
points = st.lists(st.tuples(coordinates, coordinates), min_size=1, max_size=5).map(np.array)


def image_grid() -> np.ndarray:
    x, y = np.meshgrid(np.linspace(-20, 1411, 9), np.linspace(-20, 1059, 7))
    return np.column_stack([x.ravel(), y.ravel()])


@pytest.mark.parametrize("mapping", MAPPINGS)
def test_jacobian_is_the_derivative(mapping: CameraMapping) -> None:
    X = mapping.to_specimen(image_grid())
    step = 1e-3
    numeric = np.stack([(mapping.to_image(X + step * e) - mapping.to_image(X - step * e)) / (2 * step)
                        for e in np.eye(2)], axis=2)
    # Rounding of positions of 1e3 px over the step gives 1e-10; the third derivative times step^2 is less.
    np.testing.assert_allclose(mapping.jacobian(X), numeric, atol=2e-9)


@pytest.mark.parametrize("mapping", MAPPINGS)
def test_round_trip(mapping: CameraMapping) -> None:
    x = image_grid()
    np.testing.assert_allclose(mapping.to_image(mapping.to_specimen(x)), x, atol=1e-10)


def test_distortion_is_the_stated_polynomial() -> None:
    mapping = CameraMapping(np.eye(3), np.array([100.0, 50.0]), 200.0, np.array([0.1, 0.03]))
    r = 0.5
    moved = mapping.to_image(np.array([[100.0 + 200 * r, 50.0], [100.0, 50.0 - 200 * r], [100.0, 50.0]]))
    far = 200 * r * (1 + 0.1 * r**2 + 0.03 * r**4)
    np.testing.assert_allclose(moved, [[100 + far, 50.0], [100.0, 50 - far], [100.0, 50.0]], rtol=1e-15)


@given(X=points)
def test_identity_is_exact(X: np.ndarray) -> None:
    np.testing.assert_array_equal(identity().to_image(X), X)
    np.testing.assert_array_equal(identity().to_specimen(X), X)
    np.testing.assert_array_equal(identity().jacobian(X), np.broadcast_to(np.eye(2), (len(X), 2, 2)))


@given(X=points, scale=st.floats(0.1, 20), shift=st.tuples(coordinates, coordinates))
def test_similarity_without_rotation_scales_and_shifts(X: np.ndarray, scale: float,
                                                       shift: tuple[float, float]) -> None:
    # One product and one sum: nothing but their rounding, which a fused multiply-add may spare.
    np.testing.assert_allclose(similarity(scale, 0.0, shift).to_image(X), scale * X + np.array(shift), rtol=0,
                               atol=4e-16 * (scale * np.abs(X).max() + np.abs(shift).max()))


@given(X=points, scale=st.floats(0.1, 20), degrees=st.floats(-180, 180), shift=st.tuples(coordinates, coordinates))
def test_similarity_rotates_from_x_towards_y(X: np.ndarray, scale: float, degrees: float,
                                             shift: tuple[float, float]) -> None:
    z = (X @ np.array([1, 1j])) * scale * np.exp(1j * np.deg2rad(degrees)) + complex(*shift)
    moved = similarity(scale, degrees, shift).to_image(X)
    # Rounding of numbers up to 20 * 1.4e4.
    np.testing.assert_allclose(moved @ np.array([1, 1j]), z, rtol=0, atol=1e-9)


def test_what_cannot_be_undone_is_an_error() -> None:
    # r (1 - r^2) is largest at r = 1 / sqrt(3): 0.385 of the radius of 100 px.
    folding = CameraMapping(np.eye(3), np.zeros(2), 100.0, np.array([-1.0, 0.0]))
    near_the_fold = np.array([[38.0, 0.0]])
    np.testing.assert_allclose(folding.to_image(folding.to_specimen(near_the_fold)), near_the_fold, atol=1e-10)
    with pytest.raises(ValueError, match=re.escape("cannot be undone at image position (39, 0) px")):
        folding.to_specimen(np.array([[10.0, 0.0], [39.0, 0.0]]))


def test_a_root_behind_the_fold_is_no_answer() -> None:
    # r (1 - 3 r^2 + 2 r^4) grows again beyond its fold at 0.37 and reaches 3 there; no point before it does.
    folding = CameraMapping(np.eye(3), np.zeros(2), 1.0, np.array([-3.0, 2.0]))
    with pytest.raises(ValueError, match="cannot be undone"):
        folding.to_specimen(np.array([[3.0, 0.0]]))


def test_points_beyond_the_horizon_are_an_error() -> None:
    mapping = CameraMapping(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-0.01, 0.0, 1.0]]))
    with pytest.raises(ValueError, match=re.escape("(101, 3) lies beyond the horizon")):
        mapping.to_image(np.array([[99.0, 0.0], [101.0, 3.0]]))


@pytest.mark.parametrize("radial", [(0.0, 0.0), (0.05, -0.01)])
def test_a_point_that_was_not_measured_stays_nan(radial: tuple[float, float]) -> None:
    mapping = CameraMapping(np.array([[4.0, 0.0, 9.0], [0.0, 4.0, 7.0], [1e-4, 0.0, 1.0]]), np.zeros(2), 500.0,
                            np.array(radial))
    points = np.array([[30.0, 20.0], [np.nan, np.nan], [11.0, 60.0]])
    for map_points in (mapping.to_image, mapping.to_specimen):
        mapped = map_points(points)
        np.testing.assert_array_equal(np.isnan(mapped).all(axis=1), [False, True, False])
        np.testing.assert_array_equal(mapped[[0, 2]], map_points(points[[0, 2]]))


def test_nan_is_not_named_where_another_point_lies_beyond_the_horizon() -> None:
    mapping = CameraMapping(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-0.01, 0.0, 1.0]]))
    with pytest.raises(ValueError, match=re.escape("(101, 3) lies beyond the horizon")):
        mapping.to_image(np.array([[np.nan, np.nan], [101.0, 3.0]]))


def test_a_horizon_between_image_and_origin_inverts_too() -> None:
    # The inverse's entry [2, 2] is negative here.
    mapping = CameraMapping(np.array([[1.0, 0.0, 200.0], [0.0, 1.0, 0.0], [0.01, 0.0, 1.0]]))
    X = np.array([[10.0, 20.0], [-30.0, 5.0]])
    np.testing.assert_allclose(mapping.to_specimen(mapping.to_image(X)), X, atol=1e-10)


@pytest.mark.parametrize(("change", "words"), [
    ({"homography": np.eye(2)}, "homography: expected 3 x 3"),
    ({"homography": 2 * np.eye(3)}, "divide all entries by it"),
    ({"homography": np.diag([1.0, 0.0, 1.0])}, "singular"),
    ({"centre": np.array([np.nan, 0.0])}, "centre: expected 2 finite numbers"),
    ({"radius": 0.0}, "radius: expected a positive number"),
])
def test_wrong_parameters(change: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        CameraMapping(**{"homography": np.eye(3), **change})  # type: ignore[arg-type]


def test_similarity_needs_a_positive_scale() -> None:
    with pytest.raises(ValueError, match="scale: expected a positive number"):
        similarity(-4.0, 0.0, (0.0, 0.0))
