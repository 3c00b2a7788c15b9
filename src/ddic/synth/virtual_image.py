"""A deformed image made from one's own reference image and a displacement known at its pixels."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ddic.arrays import Array

DEGREE = 5
"""Of the spline that moves the image: another one than the cubic that measures, or its errors would cancel."""

NEAR_PX = 1e-5
"""Change of a point, pixels, below which it is where it came from; a larger one blurs the known displacement."""

MOST_STEPS = 50
"""Steps after which a point stays where it is: at the sides of a crack that closes none fits."""

_ROWS = 256
"""Rows that are made at once; a larger value takes more memory."""


def render_virtual_image(grey: Array, displacement: Array) -> NDArray[np.float32]:
    """Render g(y) = f(x) with x + u(x) = y, f interpolated by a quintic spline.

    ``displacement`` is u at pixel centres, (height, width, 2), pixels, finite. Noise of f moves with the specimen and
    is texture here; interpolation smooths it. What f does not show is its mirror image.
    """
    coefficients = ndimage.spline_filter(grey, DEGREE, mode="mirror")
    affine = _fit_affine(displacement)
    bands = []
    for first in range(0, grey.shape[0], _ROWS):
        rows = np.arange(first, min(first + _ROWS, grey.shape[0]))
        y, x = np.meshgrid(rows, np.arange(grey.shape[1]), indexing="ij")
        origins = _find_origins(displacement, affine, np.stack([x, y]).astype(np.float64))
        bands.append(ndimage.map_coordinates(coefficients, origins[::-1], order=DEGREE, prefilter=False,
                                             mode="mirror").astype(np.float32))
    return np.concatenate(bands)


def _fit_affine(displacement: Array) -> tuple[Array, Array]:
    """F and t of x + u(x) = F x + t + small, by least squares over a few thousand pixels."""
    height, width, _ = displacement.shape
    y, x = np.mgrid[0:height:max(1, height // 64), 0:width:max(1, width // 64)]
    columns = np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)])
    fitted = np.linalg.lstsq(columns, displacement[y.ravel(), x.ravel()], rcond=None)[0]
    return np.eye(2) + fitted[:2].T, fitted[2]


def _find_origins(displacement: Array, affine: tuple[Array, Array], points: Array) -> Array:
    """The x of points y, both (2, rows, columns): x <- F^-1 (y - t - what is left of u at x)."""
    gradient, offset = affine
    inverse = np.linalg.inv(gradient)
    shift = offset[:, None, None]
    x = np.einsum("ij,jrc->irc", inverse, points - shift)
    for _ in range(MOST_STEPS):
        u = np.stack([ndimage.map_coordinates(displacement[..., axis], x[::-1], order=1, mode="nearest")
                      for axis in range(2)])
        # Without its affine part, so that turned and stretched images need no more steps than others.
        change = np.einsum("ij,jrc->irc", inverse, points - x - u)
        x = x + change
        if np.abs(change).max() <= NEAR_PX:
            break
    return np.asarray(x)
