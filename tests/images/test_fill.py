"""What lies under a mask reaches no pixel that counts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from ddic.images.binned import ArraySource
from ddic.images.source import fill_excluded, without_cross, without_neighbours
from ddic.images.spline import read_gradient, read_spline
from ddic.images.sub_image import MaskedSource
from ddic.images.volume import find_slopes, read_coefficients, read_values
from ddic.images.window import Window
from support.pictures import source

SIDE = 150
SEEDS = st.integers(0, 2**31 - 1)


def random_mask(rng: np.random.Generator) -> NDArray[np.bool_]:
    """Blocks, lines and single pixels left out."""
    mask = rng.random((SIDE, SIDE)) < 0.995
    for _ in range(rng.integers(0, 5)):
        x, y = rng.integers(-20, SIDE, 2)
        width, height = rng.integers(1, 70, 2)
        mask[max(y, 0): y + height, max(x, 0): x + width] = False
    return mask


def random_image(rng: np.random.Generator) -> NDArray[np.float64]:
    return rng.integers(0, 256, (SIDE, SIDE)).astype(float)


def test_the_nearest_pixel_that_counts() -> None:
    rng = np.random.default_rng(1)
    image, mask = random_image(rng), random_mask(rng)
    # Grey levels that differ everywhere tell where each came from.
    image = np.arange(image.size, dtype=float).reshape(image.shape)
    filled = fill_excluded(image, mask.astype(np.uint8))
    np.testing.assert_array_equal(filled[mask], image[mask])
    places = np.argwhere(mask)
    nearest = cKDTree(places).query(np.argwhere(~mask))[0]
    found = np.linalg.norm(np.stack(np.divmod(filled[~mask], SIDE), axis=1) - np.argwhere(~mask), axis=1)
    # The distance transform is exact to 2 % only.
    assert (found <= 1.03 * nearest + 1e-9).all()


def test_nothing_is_copied_where_nothing_is_left_out() -> None:
    image = np.ones((20, 20), dtype=np.uint8)
    assert fill_excluded(image, None) is image
    assert fill_excluded(image, np.ones((20, 20), np.uint8)) is image
    assert not fill_excluded(image, np.zeros((20, 20), np.uint8)).any()


@pytest.mark.parametrize("garbage", [0.0, 255.0, np.nan, np.inf])
@pytest.mark.parametrize("degree", [3, 5])
@given(seed=SEEDS)
def test_nothing_under_a_mask_changes_anything(degree: int, garbage: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    image, mask = random_image(rng), random_mask(rng)
    spoilt = np.where(mask, image, garbage)
    window = Window((20, 30), (120, 140))
    clean, dirty = source(image, mask), source(spoilt, mask)
    np.testing.assert_array_equal(read_spline(clean.image, window, degree, clean.find_usable).coefficients,
                                  read_spline(dirty.image, window, degree, dirty.find_usable).coefficients)
    expected, found = (read_gradient(s.image, window, degree, s.find_usable) for s in (clean, dirty))
    for name in ("values", "slopes", "usable"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


@pytest.mark.parametrize("degree", [3, 5])
@given(seed=SEEDS)
def test_pixels_that_count_are_the_same_in_every_window(degree: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    image, mask = random_image(rng), random_mask(rng)
    masked = source(image, mask)
    x, y = rng.integers(0, SIDE - 20, 2)
    window = Window((int(x), int(y)), (int(rng.integers(x + 17, SIDE + 1)), int(rng.integers(y + 17, SIDE + 1))))
    place = np.s_[window.y0: window.y1, window.x0: window.x1]
    whole, part = (read_gradient(masked.image, w, degree, masked.find_usable)
                   for w in (Window.of_size(SIDE, SIDE), window))
    assert whole.usable is not None
    np.testing.assert_array_equal(part.usable, whole.usable[place])
    counted = whole.usable[place] > 0
    for of_part, of_whole in zip(part.slopes, whole.slopes, strict=True):
        found, expected = of_part[counted], of_whole[place][counted]
        # Coefficients further away than the halo are 1e-16 of the grey levels; slopes are stored in float32.
        np.testing.assert_allclose(found, expected, rtol=0, atol=3e-5)


@settings(max_examples=20)
@given(seed=SEEDS)
def test_voxels_that_count_are_the_same_in_every_box(seed: int) -> None:
    rng = np.random.default_rng(seed)
    voxels = rng.integers(0, 256, (44, 40, 36)).astype(np.uint8)
    mask = rng.random(voxels.shape) < 0.99
    # Thicker than what is filled.
    x, y, z = rng.integers(0, 20, 3)
    mask[z:z + 24, y:y + 24, x:x + 24] = False
    masked = MaskedSource(ArraySource(Path("memory"), voxels), ArraySource(Path("mask"), mask.astype(np.uint8)))
    lower = rng.integers(0, np.array([36, 40, 44]) - 10)
    box = Window.between(lower, lower + rng.integers(10, np.array([36, 40, 44]) - lower + 1))
    place = masked.extent.locate(box)
    whole, part = (read_values(masked.image, window, masked.find_usable) for window in (masked.extent, box))
    assert whole.usable is not None
    assert part.usable is not None
    np.testing.assert_array_equal(part.usable, whole.usable[place])
    # Slopes are differences of bytes: the same to the last digit.
    counted = part.usable > 0
    for of_part, of_whole in zip(find_slopes(part), find_slopes(whole), strict=True):
        np.testing.assert_array_equal(of_part[counted], of_whole[place][counted])
    whole_g, part_g = (read_coefficients(masked.image, window, masked.find_usable) for window in (masked.extent, box))
    assert part_g.usable is not None
    # Of a voxel that counts, and of its neighbours, by which g beside it is interpolated.
    of_part, of_whole = part_g.coefficients[2:-2, 2:-2, 2:-2], whole_g.coefficients[2:-2, 2:-2, 2:-2][place]
    counted = ndimage.binary_dilation(part_g.usable > 0, np.ones((3, 3, 3)))
    # int16, whose last digit is rounded: sums of the same numbers in another order.
    np.testing.assert_allclose(of_part[counted], of_whole[counted], rtol=0, atol=1)


@given(seed=SEEDS, before=st.integers(0, 3), after=st.integers(0, 3))
def test_neighbours_of_what_is_left_out(seed: int, before: int, after: int) -> None:
    usable = random_mask(np.random.default_rng(seed)).astype(np.uint8)
    found, cross = without_neighbours(usable, before, after), without_cross(usable, after)
    for y, x in np.random.default_rng(seed).integers(0, SIDE, (40, 2)):
        rows = slice(max(y - before, 0), y + after + 1)
        assert found[y, x] == usable[rows, max(x - before, 0): x + after + 1].all()
        along = [usable[max(y - after, 0): y + after + 1, x], usable[y, max(x - after, 0): x + after + 1]]
        assert cross[y, x] == np.concatenate(along).all()
