"""Masks, and the window of the deformed image that follows the displacement."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ddic.images.source import SizedImage
from ddic.images.spline import HALO, PADDING, compute_coefficients
from ddic.images.sub_image import GROWTH, SMALLEST, DeformedSubImage, MaskedSource, read_reference
from ddic.images.window import Window
from support.pictures import source

WIDTH, HEIGHT = 300, 200


@dataclass(frozen=True)
class Recorder(SizedImage):
    """An image that remembers the windows read from it."""

    values: NDArray[np.float64]
    reads: list[Window] = field(default_factory=list)
    path: Path = Path("recorder")
    saturation: float | None = None

    @property
    def extent(self) -> Window:
        return Window.of_size(*self.values.shape[::-1])

    def read(self, window: Window) -> NDArray[Any]:
        self.reads.append(window)
        assert self.extent.contains(window)
        return self.values[window.y0: window.y1, window.x0: window.x1]


def recorder() -> Recorder:
    return Recorder(np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH)).astype(float))


def test_nothing_is_read_again_until_the_window_is_outgrown() -> None:
    image = recorder()
    deformed = DeformedSubImage(MaskedSource(image), 3)
    first = deformed.get_spline(Window((100, 80), (140, 120)))
    assert first.window == Window((100 - GROWTH, 80 - GROWTH), (140 + GROWTH, 120 + GROWTH))
    assert deformed.get_spline(Window((95, 75), (148, 128))) is first
    assert len(image.reads) == 1
    second = deformed.get_spline(Window((120, 80), (160, 120)))
    assert second.window.contains(first.window)
    assert second.window.contains(Window((120, 80), (160, 120)))
    assert len(image.reads) == 2


def test_a_window_shrinks_again_with_the_displacement() -> None:
    image = recorder()
    deformed = DeformedSubImage(MaskedSource(image), 3)
    small, large, moved = Window((100, 80), (140, 120)), Window((40, 40), (180, 140)), Window((104, 80), (150, 120))
    deformed.hold(small)
    deformed.hold(large)
    assert deformed.get_spline(large).window == large.grow(GROWTH)
    deformed.hold(small)
    assert deformed.get_spline(small).window == small.grow(GROWTH)
    assert len(image.reads) == 3
    # Outgrown, it is read anew, without what it held; a little too large, it is kept.
    deformed.hold(moved)
    assert deformed.get_spline(moved).window == moved.grow(GROWTH)
    deformed.hold(small.grow(-2))
    assert deformed.get_spline(small.grow(-2)).window == moved.grow(GROWTH)
    assert len(image.reads) == 4


def test_only_the_window_and_its_halo_are_read() -> None:
    image = recorder()
    DeformedSubImage(MaskedSource(image), 3).get_spline(Window((100, 80), (140, 120)))
    margin = GROWTH + PADDING[3] + HALO[3]
    assert image.reads == [Window((100, 80), (140, 120)).grow(margin)]


@settings(max_examples=60)
@given(data=st.data(), degree=st.sampled_from([3, 5]))
def test_every_window_asked_for_is_held_with_the_whole_images_coefficients(data: st.DataObject, degree: int) -> None:
    image = recorder()
    whole = np.pad(compute_coefficients(image.values, degree), PADDING[degree], mode="reflect")
    deformed = DeformedSubImage(MaskedSource(image), degree)
    for _ in range(3):
        x0, y0 = data.draw(st.integers(-400, 500)), data.draw(st.integers(-400, 500))
        wanted = Window((x0, y0), (x0 + data.draw(st.integers(1, 120)), y0 + data.draw(st.integers(1, 120))))
        spline = deformed.get_spline(wanted)
        held = spline.window
        assert held.contains(wanted.intersection(Window.of_size(WIDTH, HEIGHT)))
        assert Window.of_size(WIDTH, HEIGHT).contains(held)
        assert min(held.width, held.height) >= SMALLEST
        # Points outside the image are evaluated, and left out, at its nearest pixel: it must be held as well.
        for x, y in ((wanted.x0, wanted.y0), (wanted.x1 - 1, wanted.y1 - 1)):
            px, py = min(max(x, 0), WIDTH - 1), min(max(y, 0), HEIGHT - 1)
            assert held.contains(Window((px, py), (px + 1, py + 1)))
        pad = 2 * PADDING[degree]
        expected = whole[held.y0: held.y1 + pad, held.x0: held.x1 + pad]
        # float64 to 1e-14, then rounded to float32.
        np.testing.assert_allclose(spline.coefficients, expected, rtol=1.2e-7, atol=1e-9)


def test_usable_pixels_are_those_of_mask_and_saturation_together() -> None:
    values = np.full((20, 30), 100.0)
    values[3, 4] = 255.0
    mask = np.ones(values.shape, dtype=bool)
    mask[5, 6] = False
    window = Window((2, 1), (12, 9))
    both = source(values, mask, exclude_saturated=True).find_usable(window)
    assert both is not None
    assert both.shape == (8, 10)
    assert np.argwhere(both == 0).tolist() == [[2, 2], [4, 4]]
    only_mask = source(values, mask).find_usable(window)
    assert only_mask is not None
    assert np.argwhere(only_mask == 0).tolist() == [[4, 4]]
    assert source(values).find_usable(window) is None


def test_whole_images_are_read_with_what_is_left_out() -> None:
    pixels = np.array([[3.0, 250.0, 7.0], [1.0, 2.0, 255.0]])
    image = source(pixels, pixels != 7.0, exclude_saturated=True)
    whole = image.read_whole()
    assert whole.dtype == np.float64
    np.testing.assert_array_equal(whole, pixels)


@pytest.mark.parametrize("window", [Window.of_size(1, 1), Window((299, 199), (300, 200)), Window((100, 0), (101, 200))])
def test_reference_window_has_room_for_the_prefilter(window: Window) -> None:
    image = recorder()
    found = read_reference(MaskedSource(image), window, 5)
    assert found.window.contains(window)
    assert min(found.window.width, found.window.height) >= SMALLEST
    np.testing.assert_array_equal(found.values, image.values[found.window.y0: found.window.y1,
                                                             found.window.x0: found.window.x1])


@pytest.mark.parametrize("degree", [3, 5])
def test_masked_not_a_number_stays_where_it_is(degree: int) -> None:
    values = recorder().values
    values[50, 60] = np.nan
    values[51, 60] = np.inf
    mask = np.isfinite(values)
    masked = MaskedSource(Recorder(values), source(mask.astype(float)).image)
    reference = read_reference(masked, Window((40, 40), (80, 80)), degree)
    spline = DeformedSubImage(masked, degree).get_spline(Window((40, 40), (80, 80)))
    for array in (reference.values, reference.slopes, spline.coefficients):
        assert np.isfinite(array).all()
    assert reference.usable is not None
    reach = degree // 2
    expected = np.ones_like(reference.usable)
    expected[10 - reach: 12 + reach, 20] = expected[10:12, 20 - reach: 21 + reach] = 0
    np.testing.assert_array_equal(reference.usable, expected)
