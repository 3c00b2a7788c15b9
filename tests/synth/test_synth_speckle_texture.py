import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ddic.errors import InputError
from ddic.synth import speckle_kernels as kernels
from ddic.synth.speckle import SpeckleTexture, compute_moments

DIMENSIONS = pytest.mark.parametrize("d", [2, 3])


def draw(seed, lower, size, d):
    """First speckle of each cell of a square or cubic block, and the speckles."""
    cells = kernels.CellBlock((lower,) * d, (size,) * d)
    starts = kernels.count_speckles(np.uint64(seed), cells)
    return starts, kernels.draw_speckles(np.uint64(seed), cells, starts)


@pytest.fixture(scope="module", params=[(1024, 1024), (96, 96, 96)], ids=["plane", "space"])
def raster(request):
    places = np.indices(request.param)[::-1]
    return SpeckleTexture(seed=5).evaluate(*(x - origin for x, origin in zip(places, (300, 500, 40), strict=False)))


def test_mean_is_zero(raster):
    # The mean over A px of a shot-noise field has the variance density E[(integral of a speckle)^2] / A:
    # 9.5 / A in the plane, a deviation of 0.003, 50 / A in space, 0.0075; five of them.
    assert abs(raster.mean()) < {2: 0.015, 3: 0.0375}[raster.ndim]


def test_deviation_is_analytic(raster):
    # Relative deviation of a sample deviation: sqrt((2 pi sigma^2)^(d/2) / (2 A)) = 0.0025 and 0.0052; five of them.
    assert raster.std() == pytest.approx(0.6, rel={2: 0.0125, 3: 0.026}[raster.ndim])


@pytest.mark.parametrize("lag", [1, 2, 4])
def test_autocovariance_is_analytic(raster, lag):
    # A speckle correlated with itself: a^2 (pi sigma^2)^(d/2) exp(-lag^2 / (4 sigma^2)); a wrong size shows here.
    # Sampling deviation of 0.36 at small lags: twice that of the deviation; five of them, and a little.
    sigma = np.linspace(kernels.SIGMA_MIN, kernels.SIGMA_MAX, 2001)
    weights = sigma**raster.ndim / np.sum(sigma**raster.ndim)
    expected = 0.36 * np.sum(weights * np.exp(-(lag**2) / (4 * sigma**2)))
    centred = raster - raster.mean()
    for axis in range(raster.ndim):
        along = np.moveaxis(centred, axis, 0)
        assert np.mean(along[lag:] * along[:-lag]) == pytest.approx(expected, abs={2: 0.005, 3: 0.02}[raster.ndim])


def test_grey_levels_follow_tanh():
    x, y = np.random.default_rng(0).uniform(-50, 50, (2, 1000))
    texture = SpeckleTexture(seed=1)
    np.testing.assert_array_equal(texture.grey(x, y), 0.5 - 0.45 * np.tanh(texture.evaluate(x, y)))


@DIMENSIONS
def test_equals_the_plain_sum_of_untruncated_gaussians(d):
    texture = SpeckleTexture(seed=11)
    # Cells of 4 px: the points below are 24 px or more, 15 sigma, inside the block.
    _, speckles = draw(11, -12, 30 if d == 2 else 18, d)
    points = np.random.default_rng(2).uniform(-24, 48 if d == 2 else 0, (d, 500))
    squares = np.sum([(x[:, None] - center) ** 2 for x, center in zip(points, speckles.T[:d], strict=True)], axis=0)
    raw = np.exp(-squares * speckles[:, d + 1]) @ speckles[:, d]
    # The documented sum of the tails cut beyond six standard deviations.
    mean, deviation = compute_moments(d)
    expected = (raw - mean) * 0.6 / deviation
    np.testing.assert_allclose(texture.evaluate(*points), expected, rtol=0, atol={2: 1e-7, 3: 3e-7}[d])


@pytest.mark.parametrize(("d", "size"), [(2, 200), (3, 34)])
def test_speckles_have_the_stated_density_and_laws(d, size):
    starts, speckles = draw(3, -size // 2, size, d)
    counts = np.diff(starts)
    mean = kernels.DENSITY[d] * kernels.CELL_SIZE**d
    # 40,000 Poisson cells: deviations mean 0.006, variance about 0.012; five of them.
    assert counts.mean() == pytest.approx(mean, abs=0.03)
    assert counts.var() == pytest.approx(mean, abs=0.06)
    sigma = np.sqrt(0.5 / speckles[:, d + 1])
    # About 51,000 uniform draws: deviation of a mean is width / sqrt(12 x 51,000) = 0.0013 width.
    places = [(x, -2 * size, 2 * size) for x in speckles.T[:d]]
    for values, low, high in ((sigma, 1.3, 1.6), (speckles[:, d], 0.5, 1.0), *places):
        assert low <= values.min() < values.max() < high
        assert values.mean() == pytest.approx((low + high) / 2, abs=0.0065 * (high - low))
    # Independent draws: correlations have a deviation of 1 / sqrt(51,000) = 0.0044.
    assert np.abs(np.corrcoef(speckles.T) - np.eye(d + 2)).max() < 0.022
    # No cell is another one's image in a mirror: each axis has a stride of its own. Deviation 1 / sqrt(40,000).
    block = counts.reshape((size,) * d)
    for turned in (block.T, *(np.flip(block, axis) for axis in range(d)), np.roll(block, 1, 0)):
        assert abs(np.corrcoef(block.ravel(), turned.ravel())[0, 1]) < 0.025


def test_a_plane_in_space_is_another_texture():
    x, y = np.indices((60, 60))
    plane, cut = SpeckleTexture(1).evaluate(x, y), SpeckleTexture(1).evaluate(x, y, 0)
    assert abs(np.corrcoef(plane.ravel(), cut.ravel())[0, 1]) < 0.5


@given(seed=st.integers(0, 2**64 - 1), spread=st.sampled_from([3.0, 100.0, 30_000.0]), d=st.sampled_from([2, 3]))
@settings(max_examples=30, deadline=None)
def test_a_point_does_not_depend_on_its_company(seed, spread, d):
    texture = SpeckleTexture(seed)
    points = np.random.default_rng(seed).uniform(-spread, spread, (d, 40))
    alone = [texture.evaluate(*point).item() for point in points.T]
    np.testing.assert_array_equal(texture.evaluate(*points), alone)  # same speckles, same order: same bits


def test_seed_decides():
    x, y = np.meshgrid(np.arange(40.0), np.arange(40.0))
    first = SpeckleTexture(1).evaluate(x, y)
    np.testing.assert_array_equal(first, SpeckleTexture(1).evaluate(x, y))
    assert abs(np.corrcoef(first.ravel(), SpeckleTexture(2).evaluate(x, y).ravel())[0, 1]) < 0.5


def test_size_factor_magnifies():
    x, y = np.random.default_rng(0).uniform(0, 100, (2, 300))
    np.testing.assert_array_equal(SpeckleTexture(4, size_factor=2.0).evaluate(2 * x, 2 * y),
                                  SpeckleTexture(4).evaluate(x, y))  # a power of two rounds nothing


def test_shapes_broadcast():
    texture = SpeckleTexture()
    assert texture.evaluate(np.arange(3.0), np.arange(2.0)[:, None]).shape == (2, 3)
    assert texture.evaluate(np.zeros(0), np.zeros(0)).shape == (0,)


@pytest.mark.parametrize("arguments", [{"seed": -1}, {"seed": 2**64}, {"size_factor": 0.0},
                                       {"size_factor": math.nan}])
def test_impossible_parameters_are_refused(arguments):
    with pytest.raises(InputError, match=next(iter(arguments))):
        SpeckleTexture(**arguments)


def test_coordinates_must_be_finite():
    with pytest.raises(InputError, match="finite"):
        SpeckleTexture().evaluate(np.nan, 0.0)
