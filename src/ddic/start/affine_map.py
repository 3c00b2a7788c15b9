"""One affine map through displacements at points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

THIN = 0.02
"""Width of a set of points, times its length, below which they are on a line and tell no affine map. A larger value
takes a similarity for more of them."""


@dataclass(frozen=True, eq=False)
class AffineMap:
    """A displacement that is linear in the position.

    Attributes
    ----------
    centre : (2,) array
        Pixels.
    translation : (2,) array
        Displacement of the centre, pixels.
    gradient : (2, 2) array
        du_i/dx_j.
    """

    centre: Array
    translation: Array
    gradient: Array

    def at(self, points: Array) -> Array:
        """Evaluate the displacement.

        Parameters
        ----------
        points : (n, 2) array
            Pixels.

        Returns
        -------
        (n, 2) array
            Pixels.
        """
        return np.asarray(self.translation + (points - self.centre) @ self.gradient.T)


def fit_affine_map(points: Array, displacement: Array) -> AffineMap:
    """Fit the map of least squares that the points tell.

    Parameters
    ----------
    points : (n, 2) array
        At least one, pixels.
    displacement : (n, 2) array
        Pixels.

    Returns
    -------
    AffineMap
        A translation of one point, a rotation with a scale of two or of several on a line, affine of others.
    """
    centre, translation = points.mean(axis=0), displacement.mean(axis=0)
    offsets, rest = points - centre, displacement - translation
    axes = np.linalg.svd(offsets, compute_uv=False)
    if axes[0] == 0.0:
        return AffineMap(centre, translation, np.zeros((2, 2)))
    if len(axes) > 1 and axes[1] > THIN * axes[0]:
        return AffineMap(centre, translation, np.linalg.lstsq(offsets, rest, rcond=None)[0].T)
    # (1 + a + ib) (x + iy): a rotation with a scale.
    x, y = offsets.T
    square = float((offsets**2).sum())
    a = float((x * rest[:, 0] + y * rest[:, 1]).sum()) / square
    b = float((x * rest[:, 1] - y * rest[:, 0]).sum()) / square
    return AffineMap(centre, translation, np.array([[a, -b], [b, a]]))
