"""Noise of two images of one scene at rest, and how interpolation by a spline weakens and correlates it."""

from functools import cache
from math import comb, factorial, prod

import numpy as np

from ddic.arrays import Array
from ddic.images.source import ImageSource
from ddic.images.spline import HALO, compute_coefficients
from ddic.images.window import Window

BLOCKS = {2: 32, 3: 10}
"""Side, pixels, of the blocks of which each has its own light and motion, by the number of dimensions; a larger value
lets more of a drift through, a smaller one leaves fewer pixels to each block's four or five numbers."""

PART_PIXELS = 1 << 20
"""Pixels, about, that are fitted together; each takes 216 bytes meanwhile."""


def estimate_rest_noise(first: ImageSource, second: ImageSource, window: Window) -> float:
    """Estimate the noise of either image, both of one size, from their difference: its standard deviation, grey levels.

    Of every block an offset, a gain and a shift of the second image are fitted, so that neither light nor a small drift
    counts; the median over blocks passes over what has moved. It is nan where the window is smaller than a block.
    """
    side = BLOCKS[len(window.sizes)]
    whole = Window.between(window.lower, np.array(window.upper) - np.array(window.sizes) % side)
    if whole.n_pixels == 0:
        return float("nan")
    # Rows, or planes, of blocks are cut across the axis before the last.
    length = side * max(1, PART_PIXELS // (side**2 * prod(whole.sizes[:-2])))
    variances = [_fit_part(first, second, part) for row in whole.split_rows(side)
                 for part in row.split_rows(length, axis=-2)]
    return float(np.sqrt(np.median(np.concatenate(variances))))


def _fit_part(first: ImageSource, second: ImageSource, window: Window) -> Array:
    """Noise variances of whole blocks beside each other, (n_blocks,), grey levels squared."""
    f = first.read(window).astype(np.float64)
    change = second.read(window) - f
    columns = (np.ones_like(f), f, *np.gradient(f))
    design = np.stack([_split(column) for column in columns], axis=2)
    values = _split(change)[:, :, None]
    # Of blocks without texture, the columns depend on each other: hence no inverse.
    fitted = design @ (np.linalg.pinv(design) @ values)
    left = ((values - fitted) ** 2).sum(axis=(1, 2))
    # Two images' noise, less what the numbers of each block take of it.
    return np.asarray(left / (2.0 * (design.shape[1] - design.shape[2])))


def _split(image: Array) -> Array:
    """Pixels of each block, (n_blocks, n_pixels)."""
    side, dim = BLOCKS[image.ndim], image.ndim
    # Blocks, and pixels in them, along each axis in turn.
    parted = image.reshape([n for size in image.shape for n in (size // side, side)])
    return parted.transpose(*range(0, 2 * dim, 2), *range(1, 2 * dim, 2)).reshape(-1, side**dim)


REACH = 12
"""Largest distance, pixels, of values whose noise goes together: the poles' powers leave 1e-4 of it there (0.43^12)."""

NOISE_OF_SLOPE = {3: 1.39, 5: 1.89}
"""Variance of the slope of a spline through white noise at its nodes, relative to the noise's, per pixel squared, by
degree: for the cubic one the mean of (3 sin w / (2 + cos w))^2 over all frequencies w."""


def correlate_interpolation(shift: float, degree: int) -> Array:
    """Find how the noise of interpolated values goes together: R(k) = sum_m h(m) h(m + k) with the weights h of pixels.

    The B-spline of degree 3 or 5 with its prefilter weighs the pixels about a point between two of them, ``shift``
    pixels from one; h is that along one axis. In two dimensions R is the product of both axes', and the value at no
    distance is the noise transfer: the variance of an interpolated value over that of a pixel. R, (2 REACH + 1,), is
    given for k from -REACH to REACH, no unit; it is 1 at k = 0 alone where the shift is a whole number.
    """
    weights = _weigh_pixels(shift % 1.0, degree)
    whole = np.correlate(weights, weights, mode="full")
    middle = len(weights) - 1
    return np.asarray(whole[middle - REACH: middle + REACH + 1])


def _weigh_pixels(shift: float, degree: int) -> Array:
    """Weights of pixels in the value at ``shift``, of 2 HALO + 1 pixels about it."""
    n = HALO[degree]
    places = np.arange(-n, n + 1)
    # The value is sum_k c[k] B(shift - k); c of pixels that are 1 at m alone is c_0[k - m].
    basis = _evaluate_basis(shift - places, degree)
    return np.asarray(np.convolve(basis, _coefficients_of_one_pixel(degree), mode="same"))


def _evaluate_basis(x: Array, degree: int) -> Array:
    """The centred B-spline B(x) as a sum of truncated powers, from its nearer end: no difference of large numbers."""
    from_end = 0.5 * (degree + 1) - np.abs(x)
    terms = [(-1) ** k * comb(degree + 1, k) * np.maximum(from_end - k, 0.0) ** degree for k in range(degree + 1)]
    return np.asarray(np.sum(terms, axis=0) / factorial(degree))


@cache
def _coefficients_of_one_pixel(degree: int) -> Array:
    """Coefficients along a row of pixels of which the middle one is 1 and the others are 0."""
    n = HALO[degree]
    # Along columns nothing varies.
    row = np.zeros((1, 2 * n + 1))
    row[0, n] = 1.0
    return np.asarray(compute_coefficients(row, degree)[0])
