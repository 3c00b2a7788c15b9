"""Search of a picture in one of another magnification."""

from __future__ import annotations

import numpy as np
import pytest

from ddic.calibration.near import TileSearch
from ddic.images.camera import CameraMapping
from support.two_cameras import TILTED, TURNED, UPRIGHT, far_grey, near_grey


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


def test_blank_windows_match_nothing() -> None:
    far, near = far_grey(UPRIGHT).astype(np.float32), near_grey().astype(np.float32)
    # Overexposed, but for what the near image shows; what is left of blank windows is rounding, which fits anything.
    corners = UPRIGHT.to_specimen(np.array([[0.0, 0.0], np.subtract(near.shape[::-1], 1.0)]))
    (x0, y0), (x1, y1) = corners.astype(int)
    is_blank = np.ones(far.shape, dtype=bool)
    is_blank[y0:y1, x0:x1] = False
    far[is_blank] = 255.1
    match = next(TileSearch(far, near, 4.0).find_matches())
    X = UPRIGHT.to_specimen(np.array([match.centre]))
    assert 0.85 < match.coefficient < 1.0
    assert np.abs(match.mapping.to_specimen(np.array([match.centre])) - X).max() < 1.0
