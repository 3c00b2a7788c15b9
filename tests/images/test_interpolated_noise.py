"""What a spline leaves of noise, against noise that is interpolated."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from ddic.images.interpolated_noise import average_noise_transfer


@pytest.mark.parametrize("degree", [3, 5])
@pytest.mark.parametrize("offset", [(0.5, 0.5), (0.25, -0.1), (3.0, 7.5)])
def test_variance_is_that_of_interpolated_noise(degree: int, offset: tuple[float, float]) -> None:
    noise = np.random.default_rng(0).standard_normal((600, 600))
    moved = ndimage.shift(noise, offset[::-1], order=degree, mode="mirror")[30:-30, 30:-30]
    found = average_noise_transfer(np.array([offset, offset]), degree)
    # 290,000 values, neighbours of which go together: their variance is known to half a per cent.
    assert found == pytest.approx(float(moved.var()), rel=0.015)


def test_whole_pixels_keep_all_of_it_and_missing_ones_do_not_count() -> None:
    whole = np.array([[2.0, -3.0], [np.nan, 0.5]])
    assert average_noise_transfer(whole, 3) == pytest.approx(1.0, abs=1e-9)
    assert average_noise_transfer(np.full((2, 2), np.nan), 3) == 1.0
    halves = np.array([[0.0, 0.0], [0.5, 0.5]])
    mean = 0.5 * (1.0 + average_noise_transfer(halves[1:], 3))
    assert average_noise_transfer(halves, 3) == pytest.approx(mean)
