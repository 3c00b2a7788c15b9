"""The crack of this example: its images, and how far what is measured is from what they show.

python crack.py picture FOLDER writes the two images; python crack.py compare FOLDER prints the tip, its stress
intensity factor and the opening beside the known ones.
"""

import sys
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

import ddic
from ddic.synth.speckle import SpeckleTexture

Array = NDArray[np.float64]

SIZE = (640, 600)
TIP = np.array([330.0, 300.0])
FACTOR = 0.3
"""K_I over the shear modulus, px^(1/2)."""

KAPPA = (3 - 0.3) / (1 + 0.3)
"""Of plane stress and Poisson's ratio 0.3."""

NOISE = 2.0
"""Of the camera, grey levels."""


def open_crack(points: Array) -> Array:
    """Displacement about the tip of a crack that comes from the left and opens in mode I."""
    x, y = (points - TIP).T
    half = np.arctan2(y, x) / 2
    size = FACTOR / 2 * np.sqrt(np.hypot(x, y) / (2 * np.pi))
    return np.column_stack([size * np.cos(half) * (KAPPA - 1 + 2 * np.sin(half) ** 2),
                            size * np.sin(half) * (KAPPA + 1 - 2 * np.cos(half) ** 2)])


def draw_speckles(points: Array, seed: int) -> NDArray[np.uint8]:
    """Grey levels of an image whose pixels show the specimen's points."""
    grey = 255 * SpeckleTexture(4).grey(*points.T) + np.random.default_rng(seed).normal(0, NOISE, len(points))
    return np.asarray(np.clip(np.rint(grey), 0, 255), np.uint8).reshape(SIZE[::-1])


def picture(folder: Path) -> None:
    x, y = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    pixels = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    # The points that the deformed image shows; between the crack's sides it shows anything.
    origins = pixels
    for _ in range(60):
        origins = pixels - open_crack(origins)
    tifffile.imwrite(folder / "reference.tif", draw_speckles(pixels, 1))
    tifffile.imwrite(folder / "deformed.tif", draw_speckles(origins, 2))


def compare(folder: Path) -> None:
    result = ddic.open(folder / "case.vtkhdf")
    found, opening = ddic.find_crack_tip(result), ddic.measure_opening(result)
    x, y = found.position
    print(f"tip ({x:.1f}, {y:.1f}) px, exact ({TIP[0]:.1f}, {TIP[1]:.1f}) px")
    print(f"K_I / mu {found.opening_factor:.4f} px^(1/2), exact {FACTOR:.4f} px^(1/2)")
    behind = opening.points[:, 0] < TIP[0]
    exact = 2 * open_crack(opening.points[behind] + [0, 1e-9])[:, 1]
    error = opening.normal[behind] - exact
    print(f"opening up to {exact.max():.2f} px, RMS error {np.sqrt((error**2).mean()):.3f} px")


{"picture": picture, "compare": compare}[sys.argv[1]](Path(sys.argv[2]))
