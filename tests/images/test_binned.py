"""Coarse-grained images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ddic.images import binned
from ddic.images.binned import ArraySource, BinnedSource, bin_image, bin_rows
from ddic.images.sub_image import MaskedSource
from ddic.images.window import Window
from support.pictures import source


def whole(image: MaskedSource) -> np.ndarray:
    return np.asarray(image.image.read(image.extent))


@pytest.mark.parametrize("factor", [1, 2, 3, 4])
def test_pixels_are_means_of_blocks(factor: int) -> None:
    values = np.random.default_rng(0).integers(0, 65536, (37, 50)).astype(float)
    found = bin_image(source(values), factor)
    height, width = 37 // factor, 50 // factor
    assert (found.image.height, found.image.width) == (height, width)
    expected = [[values[factor * y: factor * (y + 1), factor * x: factor * (x + 1)].mean() for x in range(width)]
                for y in range(height)]
    # float32 means of float32 values.
    np.testing.assert_allclose(whole(found), expected, rtol=5e-7)
    assert found.find_usable(found.extent) is None


@pytest.mark.parametrize("factor", [2, 4])
def test_blocks_lie_where_the_docstring_says(factor: int) -> None:
    x, y = np.meshgrid(np.arange(40.0), np.arange(32.0))
    found = bin_image(source(3 * x + 5 * y), factor)
    big_x, big_y = np.meshgrid(np.arange(found.image.width), np.arange(found.image.height))
    centre = (factor - 1) / 2
    # A linear picture's mean over a block is its value at the block's centre; these are short binary fractions.
    np.testing.assert_array_equal(whole(found), 3 * (factor * big_x + centre) + 5 * (factor * big_y + centre))


def test_block_counts_where_all_its_pixels_do() -> None:
    values = np.full((12, 12), 50.0)
    values[7, 8] = 255.0
    values[2, 2] = np.nan
    mask = np.ones(values.shape, dtype=bool)
    mask[2, 2] = mask[11, 0] = False
    found = bin_image(source(values, mask, exclude_saturated=True), 3)
    usable = found.find_usable(found.extent)
    assert usable is not None
    assert np.argwhere(usable == 0).tolist() == [[0, 0], [2, 2], [3, 0]]
    assert np.isfinite(whole(found)).all()
    part = found.find_usable(Window((1, 1), (4, 4)))
    assert part is not None
    assert np.argwhere(part == 0).tolist() == [[1, 1]]


@pytest.mark.parametrize("at_once", ["_BAND_PIXELS", "_CACHED_PIXELS"])
def test_bands_change_nothing(monkeypatch: pytest.MonkeyPatch, at_once: str) -> None:
    rng = np.random.default_rng(1)
    image = source(rng.uniform(0, 255, (41, 33)), rng.random((41, 33)) < 0.95)
    whole_bands = bin_image(image, 2)
    monkeypatch.setattr(binned, at_once, 200)
    in_bands = bin_image(image, 2)
    np.testing.assert_array_equal(whole(in_bands), whole(whole_bands))
    np.testing.assert_array_equal(in_bands.find_usable(in_bands.extent), whole_bands.find_usable(whole_bands.extent))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_an_image_in_memory_gives_windows_in_its_own_type_that_nobody_writes_to(dtype: type) -> None:
    values = np.arange(30).reshape(5, 6).astype(dtype)
    image = ArraySource(Path("memory"), values)
    part = image.read(Window((1, 2), (4, 5)))
    assert part.dtype == dtype
    np.testing.assert_array_equal(part, [[13, 14, 15], [19, 20, 21], [25, 26, 27]])
    with pytest.raises(ValueError, match="read-only"):
        part[:] = 0


@pytest.mark.parametrize("window", [Window.of_size(7, 5), Window.of_size(6, 6), Window((-1, 0), (6, 5)),
                                    Window((0, -1), (6, 5)), Window((3, 2), (3, 4))])
def test_windows_outside_an_image_in_memory_are_refused(window: Window) -> None:
    with pytest.raises(ValueError, match="empty or leaves the image of 6 x 5 pixels"):
        ArraySource(Path("memory"), np.zeros((5, 6))).read(window)


@given(window=st.tuples(*[st.integers(0, 5)] * 2, *[st.integers(1, 4)] * 2), rows=st.tuples(*[st.integers(0, 20)] * 2),
       ratio=st.sampled_from([1, 2]))
def test_blocks_that_are_averaged_where_they_are_read_are_those_of_the_whole_image(
        window: tuple[int, int, int, int], rows: tuple[int, int], ratio: int) -> None:
    rng = np.random.default_rng(2)
    # Sums of whole numbers are exact in whatever order.
    image = source(rng.integers(0, 255, (41, 44)).astype(float), rng.random((41, 44)) < 0.97)
    first, end = min(rows), max(rows)
    held = bin_rows(image, 2, range(first, end))
    x, y, width, height = window
    part = Window((x, y), (x + width, y + height))
    coarse = bin_image(image, 2 * ratio)
    grey, mask = (BinnedSource(image, held, first, 2, ratio, shows_mask) for shows_mask in (False, True))
    assert (grey.extent, mask.extent) == (coarse.extent, coarse.extent)
    np.testing.assert_array_equal(grey.read(part), coarse.image.read(part))
    np.testing.assert_array_equal(mask.read(part), coarse.find_usable(part))
