"""One surface before two cameras: the far one averages over its pixels what the near one resolves."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from ddic.images.binned import ArraySource
from ddic.images.camera import CameraMapping, similarity
from ddic.synth.speckle import SpeckleTexture

FAR_SIZE, NEAR_SIZE = (130, 110), (280, 240)
SAMPLES = 5

UPRIGHT = similarity(4.0, 0.0, (-118.5, -98.5))
TURNED = similarity(4.2, -3.0, (-150.0, -105.0))
TILTED = CameraMapping(np.array([[4.1, 0.12, -150.0], [-0.1, 3.95, -85.0], [2e-4, -1.5e-4, 1.0]]))
BARREL = CameraMapping(TILTED.homography, np.array([139.5, 119.5]), float(np.hypot(*NEAR_SIZE)) / 2,
                       np.array([-0.01, 0.0]))


@cache
def near_grey(seed: int = 5) -> np.ndarray:
    """The near image, float32 (height, width) on 0..255: speckles of about 10 near px."""
    x, y = np.meshgrid(np.arange(NEAR_SIZE[0]), np.arange(NEAR_SIZE[1]))
    return 255 * SpeckleTexture(seed, 2.0).grey(x, y)


@cache
def far_grey(mapping: CameraMapping = UPRIGHT, seed: int = 5) -> np.ndarray:
    """The far image: means over SAMPLES^2 points of each far pixel."""
    along = [(np.arange(SAMPLES * n) + 0.5) / SAMPLES - 0.5 for n in FAR_SIZE]
    x, y = np.meshgrid(*along)
    image = mapping.to_image(np.column_stack([x.ravel(), y.ravel()]))
    grey = 255 * SpeckleTexture(seed, 2.0).grey(*image.T)
    return grey.reshape(FAR_SIZE[1], SAMPLES, FAR_SIZE[0], SAMPLES).mean(axis=(1, 3))


def in_memory(values: np.ndarray, name: str = "memory") -> ArraySource:
    """An image that looks like an open file."""
    return ArraySource(Path(name), np.asarray(values, dtype=np.float32))


def noisy(values: np.ndarray, seed: int, deviation: float = 2.0) -> np.ndarray:
    """An image with the noise of a camera, grey levels."""
    return values + np.random.default_rng(seed).normal(0.0, deviation, values.shape)


def corners_and_centre() -> np.ndarray:
    """Of the near image, px."""
    right, bottom = NEAR_SIZE[0] - 1, NEAR_SIZE[1] - 1
    return np.array([[0, 0], [right, 0], [0, bottom], [right, bottom], [right / 2, bottom / 2]], dtype=float)
