"""Noise of two images of one scene at rest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ddic.images import noise
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


def test_planes_of_a_volume_are_fitted_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(2)
    z, y, x = np.mgrid[0:30, 0:65, 0:60].astype(float)
    scene = 120 + 50 * np.sin(x / 3.1) * np.cos(y / 2.7) * np.cos(z / 2.9)
    first, second = (ArraySource(Path("volume"), (scene + SIGMA * random.standard_normal(scene.shape))
                                 .astype(np.float32)) for _ in range(2))
    whole = estimate_rest_noise(first, second, first.extent)
    monkeypatch.setattr(noise, "PART_PIXELS", 20 * 60 * 10)
    read = []
    monkeypatch.setattr(ArraySource, "read", lambda self, window, read_it=ArraySource.read: (
        read.append(window.n_pixels), read_it(self, window))[1])
    # The median of 108 blocks of 1000 voxels, 0.3 %; slopes at the cuts are one-sided.
    assert estimate_rest_noise(first, second, first.extent) == pytest.approx(whole, rel=0.003)
    assert whole == pytest.approx(SIGMA, rel=0.02)
    # Both volumes, each of the three slabs in three parts along y, of whole blocks.
    assert read == [20 * 60 * 10] * 18
