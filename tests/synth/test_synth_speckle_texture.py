import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ddic.errors import InputError
from ddic.synth import speckle_kernels as kernels
from ddic.synth.speckle import RAW_DEVIATION, RAW_MEAN, SpeckleTexture

SIDE = 1024


@pytest.fixture(scope="module")
def raster():
    x, y = np.meshgrid(np.arange(SIDE), np.arange(SIDE))
    return SpeckleTexture(seed=5).evaluate(x - 300, y - 500)


def test_mean_is_zero(raster):
    # The mean over A px of a shot-noise field has the variance density E[(integral of a speckle)^2] / A:
    # 9.5 / A here, a deviation of 0.003; five of them.
    assert abs(raster.mean()) < 0.015


def test_deviation_is_analytic(raster):
    # Relative deviation of a sample deviation: sqrt(2 pi sigma^2 / (2 A)) = 0.0025; five of them.
    assert raster.std() == pytest.approx(0.6, rel=0.0125)


@pytest.mark.parametrize("lag", [1, 2, 4])
def test_autocovariance_is_analytic(raster, lag):
    # A speckle correlated with itself: a^2 pi sigma^2 exp(-lag^2 / (4 sigma^2)); a wrong size shows here.
    # Sampling deviation about 0.0025 x 0.36 at small lags; five of them.
    variance = np.linspace(kernels.SIGMA_MIN, kernels.SIGMA_MAX, 2001) ** 2
    expected = 0.36 * np.sum(variance * np.exp(-(lag**2) / (4 * variance))) / variance.sum()
    centred = raster - raster.mean()
    for product in (centred[:, lag:] * centred[:, :-lag], centred[lag:] * centred[:-lag]):
        assert product.mean() == pytest.approx(expected, abs=0.005)


def test_grey_levels_follow_tanh():
    x, y = np.random.default_rng(0).uniform(-50, 50, (2, 1000))
    texture = SpeckleTexture(seed=1)
    np.testing.assert_array_equal(texture.grey(x, y), 0.5 - 0.45 * np.tanh(texture.evaluate(x, y)))


def test_equals_the_plain_sum_of_untruncated_gaussians():
    texture = SpeckleTexture(seed=11)
    first, n = -12, 30  # cells of 4 px: the points below are 24 px or more, 15 sigma, inside the block
    cells = kernels.CellBlock(first, first, n, n)
    starts = kernels.count_speckles(np.uint64(11), cells)
    speckles = kernels.draw_speckles(np.uint64(11), cells, starts)
    x, y = np.random.default_rng(2).uniform(-24, 48, (2, 500))
    squares = (x[:, None] - speckles[:, 0]) ** 2 + (y[:, None] - speckles[:, 1]) ** 2
    raw = np.exp(-squares * speckles[:, 3]) @ speckles[:, 2]
    # 1e-7 is the documented sum of the tails cut beyond six standard deviations.
    expected = (raw - RAW_MEAN) * 0.6 / RAW_DEVIATION
    np.testing.assert_allclose(texture.evaluate(x, y), expected, rtol=0, atol=1e-7)


def test_speckles_have_the_stated_density_and_laws():
    cells = kernels.CellBlock(-100, -100, 200, 200)
    starts = kernels.count_speckles(np.uint64(3), cells)
    speckles = kernels.draw_speckles(np.uint64(3), cells, starts)
    counts = np.diff(starts)
    mean = kernels.DENSITY * kernels.CELL_SIZE**2
    # 40,000 Poisson cells: deviations mean 0.0057, variance about 0.011; five of them.
    assert counts.mean() == pytest.approx(mean, abs=0.03)
    assert counts.var() == pytest.approx(mean, abs=0.055)
    sigma = np.sqrt(0.5 / speckles[:, 3])
    # About 51,000 uniform draws: deviation of a mean is width / sqrt(12 x 51,000) = 0.0013 width.
    for values, low, high in ((sigma, 1.3, 1.6), (speckles[:, 2], 0.5, 1.0), (speckles[:, 0], -400, 400),
                              (speckles[:, 1], -400, 400)):
        assert low <= values.min() < values.max() < high
        assert values.mean() == pytest.approx((low + high) / 2, abs=0.0065 * (high - low))
    # Independent draws: correlations have a deviation of 1 / sqrt(51,000) = 0.0044.
    assert np.abs(np.corrcoef(speckles.T) - np.eye(4)).max() < 0.022


@given(seed=st.integers(0, 2**64 - 1), spread=st.sampled_from([3.0, 100.0, 30_000.0]))
@settings(max_examples=20, deadline=None)
def test_a_point_does_not_depend_on_its_company(seed, spread):
    texture = SpeckleTexture(seed)
    x, y = np.random.default_rng(seed).uniform(-spread, spread, (2, 40))
    alone = [texture.evaluate(x[k], y[k]).item() for k in range(len(x))]
    np.testing.assert_array_equal(texture.evaluate(x, y), alone)  # same speckles, same order: same bits


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
