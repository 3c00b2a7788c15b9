"""What interpolation leaves of the noise of pixels, against noise that is interpolated by another program."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from ddic.images.noise import REACH, correlate_interpolation


@pytest.mark.parametrize("degree", [3, 5])
@pytest.mark.parametrize("shift", [0.0, 0.2, 0.5, -0.7])
def test_it_is_that_of_interpolated_noise(degree: int, shift: float) -> None:
    noise = np.random.default_rng(0).standard_normal((2000, 200))
    places = np.arange(50, 150) + shift
    rows, columns = np.meshgrid(np.arange(2000.0), places, indexing="ij")
    values = ndimage.map_coordinates(noise, [rows, columns], order=degree, mode="mirror")
    found = correlate_interpolation(shift, degree)
    for k in range(4):
        measured = np.mean(values[:, :90] * values[:, k:90 + k])
        # 180,000 products of noise of 1: 0.0024 at one standard deviation.
        assert found[REACH + k] == pytest.approx(measured, abs=0.012)
        assert found[REACH - k] == pytest.approx(found[REACH + k], abs=1e-12)


@pytest.mark.parametrize("degree", [3, 5])
def test_a_whole_pixel_changes_nothing_and_light_stays_light(degree: int) -> None:
    at_pixel = np.zeros(2 * REACH + 1)
    at_pixel[REACH] = 1.0
    # Rounding of the prefilter.
    np.testing.assert_allclose(correlate_interpolation(3.0, degree), at_pixel, atol=1e-12)
    # Beyond REACH the quintic spline's poles leave 0.43^12 on either side.
    assert correlate_interpolation(0.5, degree).sum() == pytest.approx(1.0, abs=2e-4)
