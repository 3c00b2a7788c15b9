"""Blurs: moments of their kernel, and images blurred window by window."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from ddic.images.binned import REACH, SMALLEST, Blur, BlurredSource
from ddic.images.window import Window
from support.pictures import source

IMAGE = np.random.default_rng(0).uniform(0, 255, (50, 60)).astype(np.float32)


def moments(blur: Blur) -> np.ndarray:
    """Sums of x x, x y and y y over the kernel, pixels squared."""
    offsets = np.arange(-blur.reach, blur.reach + 1)
    x, y = np.meshgrid(offsets, offsets)
    assert abs((blur.kernel * x).sum()) < 1e-12
    assert abs((blur.kernel * y).sum()) < 1e-12
    return np.array([[(blur.kernel * a * b).sum() for a in (x, y)] for b in (x, y)])


@pytest.mark.parametrize("direction", [0.0, 0.4, np.pi / 2, 2.5])
@pytest.mark.parametrize(("along", "across"), [(2.0, 1.0), (4.0, 0.0), (3.0, 3.0)])
def test_second_moments_are_those_of_its_deviations(along: float, across: float, direction: float) -> None:
    blur = Blur(along, across, direction)
    assert blur.kernel.sum() == pytest.approx(1.0, abs=1e-12)
    turn = np.array([[np.cos(direction), -np.sin(direction)], [np.sin(direction), np.cos(direction)]])
    expected = turn @ np.diag([along**2 + SMALLEST**2, across**2 + SMALLEST**2]) @ turn.T
    # Cut at 3 deviations a Gaussian loses 2.7 % of its second moment, and a sampled line of none across is as wide as
    # the grid asks for: 1/12 px^2 where it runs askew.
    np.testing.assert_allclose(moments(blur), expected, atol=0.04 * along**2 + 1 / 12)


def test_nothing_is_blurred_by_nothing() -> None:
    blur = Blur(0.0, 0.0, 0.3)
    assert blur.reach == 0
    np.testing.assert_array_equal(blur.apply(IMAGE), IMAGE)


def test_it_is_a_gaussian_filter() -> None:
    # scipy's is truncated at the same reach where its deviation is that of the kernel.
    blur = Blur(2.0, 2.0, 0.7)
    deviation = np.hypot(2.0, SMALLEST)
    expected = ndimage.gaussian_filter(IMAGE.astype(float), deviation, mode="mirror", radius=blur.reach)
    assert blur.reach == REACH * 2.0
    # float32 of 255 grey levels, through a Fourier transform.
    np.testing.assert_allclose(blur.apply(IMAGE), expected, atol=1e-3)


@pytest.mark.parametrize("window", [Window.of_size(60, 50), Window((20, 15), (40, 30)), Window((0, 40), (10, 50))])
def test_a_window_is_that_of_the_whole_image(window: Window) -> None:
    blur = Blur(2.5, 1.0, 0.5)
    blurred = BlurredSource(source(IMAGE), blur)
    whole = blur.apply(IMAGE)
    np.testing.assert_allclose(blurred.read(window), whole[window.y0:window.y1, window.x0:window.x1], atol=1e-3)
    assert (blurred.width, blurred.height) == (60, 50)
    assert blurred.path == Path("memory")
    assert blurred.saturation is None


def test_what_is_masked_reaches_no_pixel_beside_it() -> None:
    mask = np.ones(IMAGE.shape, dtype=bool)
    mask[20:30, 20:35] = False
    other = np.where(mask, IMAGE, 0.0).astype(np.float32)
    one, two = (BlurredSource(source(image, mask), Blur(2.0, 1.0, 0.2)).read(Window.of_size(60, 50))
                for image in (IMAGE, other))
    np.testing.assert_array_equal(one, two)
