"""Noise of two images of one scene at rest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ddic.images.binned import ArraySource
from ddic.images.noise import estimate_rest_noise
from ddic.images.window import Window

SIGMA = 2.0


def _scene(shift: float) -> np.ndarray:
    y, x = np.mgrid[0:256, 0:320].astype(float)
    return np.asarray(120 + 50 * np.sin((x + shift) / 3.1) * np.cos((y - shift) / 2.7))


def _estimate(second: np.ndarray, width: int = 320) -> float:
    random = np.random.default_rng(1)
    first = _scene(0.0) + SIGMA * random.standard_normal((256, 320))
    noisy = second + SIGMA * random.standard_normal((256, 320))
    sources = [ArraySource(Path("image"), image.astype(np.float32)) for image in (first, noisy)]
    return estimate_rest_noise(*sources, Window.of_size(width, 256))


@pytest.mark.parametrize("second", [_scene(0.0), 1.03 * _scene(0.0) + 4.0, _scene(0.05)],
                         ids=["same", "light", "drift"])
def test_neither_light_nor_a_small_drift_counts(second: np.ndarray) -> None:
    # The median of 80 blocks of 1024 pixels: 0.3 %. Noise of the regressors takes less than that, their curvature over
    # a drift of 0.05 px too.
    assert _estimate(second) == pytest.approx(SIGMA, rel=0.02)


def test_what_moves_in_a_few_blocks_does_not_count() -> None:
    second = _scene(0.0)
    second[:64, :96] = 30.0
    assert _estimate(second) == pytest.approx(SIGMA, rel=0.02)


def test_less_than_a_block_tells_nothing() -> None:
    assert np.isnan(_estimate(_scene(0.0), width=20))
