"""Spoilt pixels of a cell against plain loops, and what must not be called spoilt."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from ddic.functionals.spoilt_pixels import ABOUT, BEYOND_NOISE, MARGIN, WEAK_SHARE, CellPatch, find_spoilt_pixels

SIDE = 30
NOISE = 8.0
"""Variance of the residual: 2 grey levels of each image."""

LIMIT = 0.5


def speckle(seed: int = 0) -> NDArray[np.float64]:
    smooth = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal((SIDE, SIDE)), 1.5)
    return np.asarray(128.0 + 40.0 * smooth / smooth.std())


def patch_of(g: NDArray[np.float64], f: NDArray[np.float64], counts: NDArray[np.bool_] | None = None) -> CellPatch:
    by_y, by_x = np.gradient(f)
    return CellPatch(np.ones(f.shape, dtype=bool) if counts is None else counts, f, g, by_x**2 + by_y**2)


def noisy(f: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(f + np.sqrt(NOISE) * np.random.default_rng(1).standard_normal(f.shape))


def find_slowly(patch: CellPatch) -> NDArray[np.bool_]:
    """The same, pixel by pixel, for cells without a brightness of their own."""
    counted = np.argwhere(patch.counts)
    weak = WEAK_SHARE * np.mean([patch.energy[y, x] for y, x in counted])
    spoilt = []
    for y, x in counted:
        about = [(j, i) for j, i in counted if max(abs(j - y), abs(i - x)) <= ABOUT[2] // 2]
        residual = np.mean([(patch.f[p] - patch.g[p])**2 for p in about])
        texture = max(np.mean([patch.energy[p] for p in about]), weak)
        if residual > BEYOND_NOISE * NOISE and residual - NOISE > texture * LIMIT**2 / 2:
            spoilt.append((y, x))
    found = np.zeros(patch.counts.shape, dtype=bool)
    for y, x in counted:
        found[y, x] = any(max(abs(j - y), abs(i - x)) <= MARGIN for j, i in spoilt)
    return found


@pytest.mark.parametrize("seed", range(5))
def test_it_finds_what_plain_loops_find(seed: int) -> None:
    random = np.random.default_rng(seed)
    f = speckle(seed)
    g = noisy(f)
    y, x = random.integers(4, SIDE - 10, 2)
    g[y:y + 6, x:x + 6] = 10.0
    # What does not count holds anything, and the cell is no rectangle.
    counts = np.add.outer(np.arange(SIDE), np.arange(SIDE)) > 8
    counts &= random.random(counts.shape) > 0.05
    g[~counts] = 1e4
    patch = patch_of(g, f, counts)
    found = find_spoilt_pixels(patch, NOISE, LIMIT, own_brightness=False)
    np.testing.assert_array_equal(found, find_slowly(patch))
    assert found.any()
    assert not found[~counts].any()


@pytest.mark.parametrize("own", [False, True])
def test_noise_is_not_spoilt(own: bool) -> None:
    for seed in range(20):
        f = speckle(seed)
        assert not find_spoilt_pixels(patch_of(noisy(f), f), NOISE, LIMIT, own_brightness=own).any()


def test_a_displacement_below_the_limit_is_not_spoilt_and_one_far_above_is() -> None:
    f = speckle()
    # f(x + e) - f(x) has the mean square |grad f|^2 e^2 / 2 where speckle has no direction; about a pixel it varies.
    shares = [find_spoilt_pixels(patch_of(ndimage.shift(f, (0, e), order=3, mode="nearest"), f), 0.0, LIMIT,
                                 own_brightness=False).mean() for e in (0.2, 2.0)]
    assert shares[0] == 0.0
    assert shares[1] > 0.8


def test_brightness_of_the_cell_is_no_dirt_where_cells_have_their_own() -> None:
    f = speckle()
    g = (noisy(f) - 15.0) / 1.3
    assert find_spoilt_pixels(patch_of(g, f), NOISE, LIMIT, own_brightness=False).mean() > 0.5
    assert not find_spoilt_pixels(patch_of(g, f), NOISE, LIMIT, own_brightness=True).any()
    # Nor does it hide a spot, whose pixels must not count in gain and offset: least squares of all would.
    g[5:14, 5:14] = 250.0
    spot = np.zeros(f.shape, dtype=bool)
    spot[5:14, 5:14] = True
    found = find_spoilt_pixels(patch_of(g, f), NOISE, LIMIT, own_brightness=True)
    assert found[spot].all()
    # Pixels that are looked at together, and the margin.
    reach = ABOUT[2] // 2 + MARGIN
    assert not found[~ndimage.binary_dilation(spot, np.ones((2 * reach + 1, 2 * reach + 1)))].any()


def test_a_cell_that_shows_no_speckle_is_spoilt_altogether() -> None:
    f = speckle()
    counts = np.ones(f.shape, dtype=bool)
    counts[:, :5] = False
    found = find_spoilt_pixels(patch_of(np.full(f.shape, 60.0), f, counts), NOISE, LIMIT, own_brightness=True)
    np.testing.assert_array_equal(found, counts)


def test_a_cell_without_pixels_has_no_spoilt_ones() -> None:
    f = speckle()
    patch = patch_of(f, f, np.zeros(f.shape, dtype=bool))
    assert not find_spoilt_pixels(patch, NOISE, LIMIT, own_brightness=True).any()
