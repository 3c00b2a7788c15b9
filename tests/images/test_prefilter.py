"""The recursive prefilter against scipy's, and slopes against the spline's taps along both axes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from ddic.images.prefilter import (
    POLES,
    STRIP,
    TERMS,
    prefilter,
    prefilter_columns,
    prefilter_rows,
    write_column_slopes,
    write_row_slopes,
)
from ddic.images.spline import HALO

DEGREES = pytest.mark.parametrize("degree", [3, 5])
VALUE_TAPS = {3: np.array([1.0, 4.0, 1.0]) / 6.0, 5: np.array([1.0, 26.0, 66.0, 26.0, 1.0]) / 120.0}
SLOPES = {3: np.array([-1.0, 0.0, 1.0]) / 2.0, 5: np.array([-1.0, -10.0, 0.0, 10.0, 1.0]) / 24.0}


@DEGREES
@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), height=st.integers(2, 70), width=st.integers(2, 70))
def test_coefficients_equal_those_of_scipy(degree: int, seed: int, height: int, width: int) -> None:
    image = np.random.default_rng(seed).uniform(0.0, 255.0, (height, width))
    found = image.copy()
    prefilter(found, degree)
    expected = ndimage.spline_filter(image, order=degree, mode="mirror")
    # Coefficients of white noise reach ten times the grey levels; some ten roundings of 1e-16 each.
    np.testing.assert_allclose(found, expected, atol=2550 * 1e-14)


@DEGREES
@pytest.mark.parametrize("shape", [(1, 1), (1, 30), (30, 1), (20, STRIP + 3), (35, 2 * STRIP)])
def test_coefficients_give_the_pixels_back(degree: int, shape: tuple[int, int]) -> None:
    image = np.random.default_rng(0).uniform(0.0, 255.0, shape)
    coefficients = image.copy()
    prefilter(coefficients, degree)
    values = ndimage.correlate1d(coefficients, VALUE_TAPS[degree], axis=0, mode="mirror")
    values = ndimage.correlate1d(values, VALUE_TAPS[degree], axis=1, mode="mirror")
    np.testing.assert_allclose(values, image, atol=2550 * 1e-14)


@DEGREES
def test_poles_decay_as_fast_as_the_halo_and_the_series_say(degree: int) -> None:
    z = np.abs(POLES[degree]).max()
    assert z ** HALO[degree] < 1.1e-16
    assert z ** TERMS[degree] < 1.1e-17
    # Roots of the polynomial of the values at integers.
    for pole in POLES[degree]:
        assert abs(np.polyval(VALUE_TAPS[degree], pole)) < 1e-15


@DEGREES
@pytest.mark.parametrize(("first", "n"), [(0, 41), (7, 20), (40, 1), (0, 1)])
def test_slopes_along_one_axis_equal_those_of_the_spline_in_both(degree: int, first: int, n: int) -> None:
    image = np.random.default_rng(degree).uniform(0.0, 255.0, (41, 41))
    both = ndimage.spline_filter(image, order=degree, mode="mirror")
    by_x = ndimage.correlate1d(ndimage.correlate1d(both, VALUE_TAPS[degree], axis=0, mode="mirror"), SLOPES[degree],
                               axis=1, mode="mirror")
    by_y = ndimage.correlate1d(ndimage.correlate1d(both, SLOPES[degree], axis=0, mode="mirror"), VALUE_TAPS[degree],
                               axis=1, mode="mirror")
    along_y = image.copy()
    prefilter_columns(along_y, degree)
    found_x, found_y = np.empty((41, n), dtype=np.float32), np.empty((n, 41), dtype=np.float32)
    write_row_slopes(image, first, degree, found_x)
    write_column_slopes(along_y, first, degree, found_y)
    # Rounded to float32 (6e-8 of some hundred grey levels per pixel).
    np.testing.assert_allclose(found_x, by_x[:, first: first + n], rtol=1.2e-7, atol=1e-9)
    np.testing.assert_allclose(found_y, by_y[first: first + n], rtol=1.2e-7, atol=1e-9)


@pytest.mark.parametrize("width", [1, 2, 3, 4, 5])
def test_narrow_blocks_have_slopes(width: int) -> None:
    image = np.random.default_rng(1).uniform(0.0, 255.0, (3, width))
    for degree in (3, 5):
        coefficients = image.copy()
        prefilter_rows(coefficients, degree)
        found = np.empty((3, width), dtype=np.float32)
        write_row_slopes(image, 0, degree, found)
        index = np.array([_reflect(int(k), width) for k in np.arange(-2, width + 2)])
        wide = coefficients[:, index]
        expected = sum(w * wide[:, k: k + width] for k, w in enumerate(np.pad(SLOPES[degree], (5 - degree) // 2)))
        np.testing.assert_allclose(found, expected, rtol=1.2e-7, atol=1e-9)


def _reflect(k: int, n: int) -> int:
    while n > 1 and not 0 <= k < n:
        k = -k if k < 0 else 2 * n - 2 - k
    return 0 if n == 1 else k
