"""Families of camera mappings."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest
from numpy.typing import NDArray

from ddic.calibration.camera_models import CameraModel, Kind, fit_similarity
from ddic.images.camera import CameraMapping, similarity
from support.two_cameras import BARREL, TILTED, TURNED, UPRIGHT, corners_and_centre

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
