"""Search of a picture in one of another magnification."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.calibration.near import TileSearch, correlate_template, sum_window_squares
from ddic.images.camera import CameraMapping
from support.two_cameras import TILTED, TURNED, UPRIGHT, far_grey, near_grey


def test_coefficients_are_those_of_the_definition() -> None:
    rng = np.random.default_rng(3)
    image, template = rng.normal(size=(14, 17)).astype(np.float32), rng.normal(size=(5, 5)).astype(np.float32)
    found = correlate_template(image - image.mean(), sum_window_squares(image - image.mean(), 5), template)
    assert found.shape == (10, 13)
    for row, column in ((0, 0), (9, 12), (4, 7)):
        window = image[row:row + 5, column:column + 5]
        # float32 products of numbers of order 1.
        assert found[row, column] == pytest.approx(np.corrcoef(window.ravel(), template.ravel())[0, 1], abs=1e-5)


def test_blank_windows_and_templates_match_nothing() -> None:
    image = np.zeros((12, 12), dtype=np.float32)
    image[:6] = np.random.default_rng(3).normal(size=(6, 12))
    found = correlate_template(image, sum_window_squares(image, 4), image[1:5, 2:6].copy())
    assert found[1, 2] == pytest.approx(1.0, abs=1e-5)
    assert (found[6:] == -1.0).all()
    assert (correlate_template(image, sum_window_squares(image, 4), np.full((4, 4), 7.1, np.float32)) == -1.0).all()


@pytest.mark.parametrize(("mapping", "ratio"), [(UPRIGHT, 4.0), (UPRIGHT, 4.5), (UPRIGHT, 3.5), (TURNED, 4.2),
                                                (TURNED, 3.8), (TILTED, 4.0)])
def test_a_tile_is_found_within_a_far_pixel(mapping: CameraMapping, ratio: float) -> None:
    search = TileSearch(far_grey(mapping).astype(np.float32), near_grey().astype(np.float32), ratio)
    match = next(search.find_matches())
    assert match.coefficient > 0.85
    X = mapping.to_specimen(np.array([match.centre]))
    # One far px is what Gauss-Newton can start from; whole pixels are tried, and ratios a few per cent apart.
    assert np.abs(match.mapping.to_specimen(np.array([match.centre])) - X).max() < 1.0
    # A ratio that is off by 5 % moves the tile's corners by 1.5 far px.
    assert abs(np.sqrt(np.linalg.det(match.mapping.jacobian(X)[0]) / np.linalg.det(mapping.jacobian(X)[0])) - 1) < 0.05
