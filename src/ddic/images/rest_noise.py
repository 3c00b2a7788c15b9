"""Noise of two images of one scene at rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.images.source import ImageSource
from ddic.images.window import Window

Array = NDArray[np.float64]

BLOCK = 32
"""Side, pixels, of the blocks of which each has its own light and motion; a larger value lets more of a drift through,
a smaller one leaves fewer pixels to each block's four numbers."""


def estimate_rest_noise(first: ImageSource, second: ImageSource, window: Window) -> float:
    """Estimate the noise of either image from their difference.

    Of every block an offset, a gain and a shift of the second image are fitted, so that neither light nor a small drift
    counts; the median over blocks passes over what has moved.

    Parameters
    ----------
    first, second : ImageSource
        Of one size.
    window : Window
        What is compared.

    Returns
    -------
    float
        Standard deviation, grey levels; nan where the window is smaller than a block.
    """
    variances = [_fit_row(first, second, Window(window.x0, y, window.x1, y + BLOCK))
                 for y in range(window.y0, window.y1 - BLOCK + 1, BLOCK)]
    found = np.concatenate([np.zeros(0), *variances])
    return float(np.sqrt(np.median(found))) if len(found) else float("nan")


def _fit_row(first: ImageSource, second: ImageSource, window: Window) -> Array:
    """Noise variances of a row of blocks, (n_blocks,), grey levels squared."""
    n = window.width // BLOCK
    f = first.read(window).astype(np.float64)[:, :n * BLOCK]
    change = second.read(window)[:, :n * BLOCK] - f
    if n == 0:
        return np.zeros(0)
    columns = (np.ones_like(f), f, *np.gradient(f))
    design = np.stack([_split(column) for column in columns], axis=2)
    values = _split(change)[:, :, None]
    # Of blocks without texture, the columns depend on each other: hence no inverse.
    fitted = design @ (np.linalg.pinv(design) @ values)
    left = ((values - fitted) ** 2).sum(axis=(1, 2))
    # Two images' noise, less what the numbers of each block take of it.
    return np.asarray(left / (2.0 * (BLOCK**2 - design.shape[2])))


def _split(image: Array) -> Array:
    """Pixels of each block of a row, (n_blocks, BLOCK^2)."""
    return image.reshape(BLOCK, -1, BLOCK).transpose(1, 0, 2).reshape(-1, BLOCK**2)
