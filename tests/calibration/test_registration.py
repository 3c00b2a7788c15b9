"""Families of camera mappings, and the registration of a near image in a far one."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.calibration.registration import CameraModel, Kind, Registration, fit_similarity, read_near_image, register
from ddic.errors import ConvergenceError
from ddic.images.camera import CameraMapping, similarity
from ddic.images.spline import read_gradient
from ddic.images.window import Window
from support.two_cameras import (
    BARREL,
    FAR_SIZE,
    NEAR_SIZE,
    SAMPLES,
    TILTED,
    TURNED,
    UPRIGHT,
    corners_and_centre,
    far_grey,
    in_memory,
    near_grey,
    noisy,
)

POINTS = np.array([[40.0, 30.0], [95.0, 41.0], [55.0, 80.0], [70.0, 52.0]])


def model(kind: Kind, distorts: bool = False, middle: tuple[float, float] = (66.0, 54.0)) -> CameraModel:
    return CameraModel(kind, 4.0, np.array(middle), 35.0, BARREL.centre, BARREL.radius, distorts)


@pytest.mark.parametrize("kind", get_args(Kind))
@pytest.mark.parametrize("distorts", [False, True])
def test_derivatives_are_those_of_the_mapping(kind: Kind, distorts: bool) -> None:
    m = model(kind, distorts)
    p = m.fit(BARREL)
    assert len(p) == m.n_parameters
    step = 1e-4

    def positions(parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        return m.build_mapping(parameters).to_image(POINTS)

    numeric = np.stack([(positions(p + step * e) - positions(p - step * e)) / (2 * step) for e in np.eye(len(p))],
                       axis=2)
    # Derivatives by the projective entries are 300 px; their second differences over step^2 are 1e-5 of them.
    np.testing.assert_allclose(m.differentiate(p, POINTS), numeric, rtol=2e-6, atol=2e-6)


@pytest.mark.parametrize(("kind", "mapping"), [("translation", UPRIGHT), ("similarity", TURNED), ("homography", TILTED),
                                               ("homography", BARREL)])
def test_a_mapping_of_the_kind_is_represented_exactly(kind: Kind, mapping: CameraMapping) -> None:
    m = model(kind, mapping.distorts)
    again = m.build_mapping(m.fit(mapping))
    np.testing.assert_allclose(again.to_image(POINTS), mapping.to_image(POINTS), atol=1e-10)


def test_other_mappings_are_represented_at_the_middle() -> None:
    m = model("similarity", middle=tuple(POINTS[0]))
    np.testing.assert_allclose(m.build_mapping(m.fit(TILTED)).to_image(POINTS[:1]), TILTED.to_image(POINTS[:1]),
                               atol=1e-10)


def test_closest_similarity_of_a_similarity_is_itself() -> None:
    found, rest = fit_similarity(TURNED, POINTS)
    np.testing.assert_allclose(found.homography, TURNED.homography, atol=1e-11)
    np.testing.assert_allclose(rest, 0.0, atol=1e-11)


def test_closest_similarity_is_the_least_squares_one() -> None:
    X = TILTED.to_specimen(corners_and_centre())
    found, rest = fit_similarity(TILTED, X)
    h = found.homography
    best = (rest**2).sum()
    for scale, turn, dx in ((1.001, 0, 0), (1, 0.05, 0), (1, 0, 0.3), (0.999, -0.05, 0)):
        other = similarity(scale * np.hypot(h[0, 0], h[1, 0]), np.rad2deg(np.arctan2(h[1, 0], h[0, 0])) + turn,
                           (h[0, 2] + dx, h[1, 2]))
        assert ((TILTED.to_image(X) - other.to_image(X))**2).sum() > best


PART = Window.of_size(*NEAR_SIZE)


def registered(far: np.ndarray, near: np.ndarray, kind: Kind, start: CameraMapping, distorts: bool = False,
               samples: int = SAMPLES) -> Registration:
    middle = start.to_specimen(corners_and_centre()[4:])[0]
    model = CameraModel(kind, 4.0, middle, 35.0, BARREL.centre, BARREL.radius, distorts)
    far_gradient = read_gradient(in_memory(far), Window.of_size(*FAR_SIZE), 3)
    return register(far_gradient, read_near_image(in_memory(near), samples), model, model.fit(start), PART)


def start_of(mapping: CameraMapping) -> CameraMapping:
    """Half a far px and 1 % off."""
    homography = np.diag([1.01, 1.01, 1.0]) @ mapping.homography
    homography[:2, 2] += (-1.0, 0.5)
    return CameraMapping(homography)


def error_of(found: Registration, mapping: CameraMapping) -> np.ndarray:
    X = mapping.to_specimen(corners_and_centre())
    return found.mapping.to_image(X) - mapping.to_image(X)


@pytest.mark.parametrize(("kind", "mapping"), [("translation", UPRIGHT), ("similarity", TURNED), ("homography", TILTED),
                                               ("homography", BARREL)])
def test_known_mappings_are_found(kind: Kind, mapping: CameraMapping) -> None:
    found = registered(far_grey(mapping), near_grey(), kind, start_of(mapping), mapping.distorts)
    # Without noise only the near spline's error is left: 1e-3 of its px at spots of 10 px, less on average.
    np.testing.assert_allclose(error_of(found, mapping), 0.0, atol=2e-3)
    assert found.coefficient > 0.99999
    assert found.local_coefficient > 0.9999
    if mapping.distorts:
        assert found.parameters[-1] == pytest.approx(-0.01, abs=1e-5)


def test_grey_levels_of_another_camera_do_not_matter() -> None:
    plain = registered(far_grey(TILTED), near_grey(), "homography", start_of(TILTED))
    other = registered(0.4 * far_grey(TILTED) + 30, near_grey(), "homography", start_of(TILTED))
    # Both stop when the corners move by less than 1e-4 px.
    np.testing.assert_allclose(error_of(other, TILTED), error_of(plain, TILTED), atol=2e-4)
    assert (other.gain, other.offset) == (pytest.approx(0.4, rel=1e-3), pytest.approx(30, abs=0.1))


def test_uncertainty_is_the_scatter_over_noise() -> None:
    runs = [registered(noisy(far_grey(TILTED), 2 * k), noisy(near_grey(), 2 * k + 1), "homography", TILTED)
            for k in range(10)]
    X = TILTED.to_specimen(corners_and_centre())
    squares = []
    for found in runs:
        D = found.model.differentiate(found.parameters, X)
        std = np.sqrt(np.einsum("nip,pq,niq->ni", D, found.covariance, D))
        squares.append((error_of(found, TILTED) / std)**2)
    # 10 x 10 numbers, of which some 80 are independent: chi^2 / n is 1 within 3 sqrt(2 / 80).
    assert 0.5 < np.mean(squares) < 1.5


def test_what_only_the_near_camera_resolves_does_not_bias() -> None:
    rng = np.random.default_rng(8)
    fine = np.kron(rng.normal(0, 60, (NEAR_SIZE[1] // 2, NEAR_SIZE[0] // 2)), np.ones((2, 2)))
    found = registered(far_grey(TILTED), near_grey() + fine, "homography", start_of(TILTED))
    X = TILTED.to_specimen(corners_and_centre())
    D = found.model.differentiate(found.parameters, X)
    std = np.sqrt(np.einsum("nip,pq,niq->ni", D, found.covariance, D))
    assert (std > 0.005).all()
    # Ten numbers within four standard deviations, the corners being correlated.
    assert np.abs(error_of(found, TILTED) / std).max() < 4


def test_a_start_that_is_far_off_is_no_result() -> None:
    far, near = far_grey(UPRIGHT), near_grey()
    with pytest.raises(ConvergenceError, match="registration of the near image"):
        registered(far, near, "homography", similarity(4.0, 0.0, (-5000.0, 0.0)))
    try:
        found = registered(far, near, "similarity", similarity(4.0, 0.0, (-60.0, -160.0)))
    except ConvergenceError:
        return
    assert found.local_coefficient < 0.5
