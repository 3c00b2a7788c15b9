"""Rigid translation by masked correlation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from ddic.images.rigid import RigidShift, find_rigid_shift
from ddic.synth.fields import Translation
from support.pictures import pair_of

SIDE = 192


def picture(seed: int, height: int, width: int) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(size=(height, width))
    return 128 + 300 * ndimage.gaussian_filter(noise, 1.6)


@settings(max_examples=40)
@given(seed=st.integers(0, 1000), dx=st.integers(-35, 35), dy=st.integers(-25, 25))
def test_whole_pixels_are_found_exactly(seed: int, dx: int, dy: int) -> None:
    height, width = 75, 91
    big = picture(seed, height + 80, width + 80)
    f = big[40: 40 + height, 40: 40 + width]
    g = big[40 - dy: 40 - dy + height, 40 - dx: 40 - dx + width]
    region = np.zeros(f.shape, dtype=bool)
    region[26: 48, 36: 55] = True  # stays inside g for every shift
    found = find_rigid_shift(f, g, region)
    assert found.coefficient == pytest.approx(1.0, abs=1e-6)
    # The parabola's vertex: half a pixel at most by construction, a tenth where the peak is not symmetric.
    np.testing.assert_allclose(found.shift, (dx, dy), atol=0.15)


@pytest.mark.parametrize("shift", [(7.3, -4.6), (-20.5, 0.25), (0.0, 31.75)])
def test_fractions_of_a_pixel(shift: tuple[float, float]) -> None:
    pair = pair_of(Translation(shift))
    region = np.zeros((SIDE, SIDE), dtype=bool)
    region[40:150, 40:150] = True
    found = find_rigid_shift(pair.reference.astype(float), pair.deformed.astype(float), region)
    # The peak is no parabola: through its three values the error was 0.05 px where it is largest, at quarters.
    np.testing.assert_allclose(found.shift, shift, atol=0.07)
    assert found.coefficient > 0.9


def test_brightness_and_contrast_do_not_matter() -> None:
    pair = pair_of(Translation((7.3, -4.6)))
    f, g = pair.reference.astype(float), pair.deformed.astype(float)
    region = np.zeros(f.shape, dtype=bool)
    region[40:150, 40:150] = True
    plain, changed = find_rigid_shift(f, g, region), find_rigid_shift(f, 3.0 * g - 40.0, region)
    # The same sums but for rounding.
    np.testing.assert_allclose(changed.shift, plain.shift, atol=1e-6)
    assert changed.coefficient == pytest.approx(plain.coefficient, abs=1e-9)


def test_what_lies_outside_the_region_does_not_matter() -> None:
    pair = pair_of(Translation((7.3, -4.6)))
    f, g = pair.reference.astype(float), pair.deformed.astype(float)
    x, y = np.meshgrid(np.arange(SIDE), np.arange(SIDE))
    region = (x - 90) ** 2 + (y - 100) ** 2 < 45**2
    blank = np.where(region, f, 20.0)
    expected = find_rigid_shift(f, g, region).shift
    np.testing.assert_allclose(find_rigid_shift(blank, g, region).shift, expected, atol=1e-9)


def test_region_may_leave_the_image_by_less_than_half() -> None:
    big = picture(3, 200, 200)
    f, g = big[40:140, 40:140], big[40:140, 75:175]  # g(x - 35) = f(x)
    found = find_rigid_shift(f, g, np.ones(f.shape, dtype=bool))
    np.testing.assert_allclose(found.shift, (-35.0, 0.0), atol=0.15)


@pytest.mark.parametrize("shift", [(-35, 0), (22, -18), (0, 41), (-9, 30)])
def test_the_coefficient_is_that_of_the_pixels_that_stay_in_the_image(shift: tuple[int, int]) -> None:
    height, width, (dx, dy) = 110, 131, shift
    big = picture(3, height + 100, width + 100)
    f = big[50:50 + height, 50:50 + width]
    noise = np.random.default_rng(1).normal(0.0, 20.0, f.shape)
    g = big[50 - dy:50 - dy + height, 50 - dx:50 - dx + width] + noise
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    # It reaches two edges, and has a hole.
    region = (x > 7) & (y < 90) & ((x - 60) ** 2 + (y - 50) ** 2 > 15**2)
    stays = region & (x + dx >= 0) & (x + dx < width) & (y + dy >= 0) & (y + dy < height)
    assert stays.sum() < region.sum()
    expected = np.corrcoef(f[stays], g[y[stays] + dy, x[stays] + dx])[0, 1]
    found = find_rigid_shift(f, g, region)
    # Fourier transforms round at 1e-13 of the sums.
    assert found.coefficient == pytest.approx(expected, abs=1e-9)
    np.testing.assert_allclose(found.shift, shift, atol=0.15)


def test_flat_images_give_no_shift() -> None:
    flat = np.full((40, 50), 7.0)
    found = find_rigid_shift(flat, flat, np.ones(flat.shape, dtype=bool))
    assert (found.shift, found.coefficient) == ((0.0, 0.0), -1.0)


def test_a_shift_of_binned_images_is_scaled_to_pixels() -> None:
    assert RigidShift((1.5, -0.25), 0.8, 3).scale(4) == RigidShift((6.0, -1.0), 0.8, 3)
