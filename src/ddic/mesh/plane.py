"""Points and vectors of the plane: rotation, cross product, the nearest of some points."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


def build_rotation(angle: float) -> NDArray[np.float64]:
    """Build the matrix of a rotation of the plane.

    Parameters
    ----------
    angle : float
        From x towards y, radians.

    Returns
    -------
    (2, 2) array
        R, which turns a vector v to R v.
    """
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def multiply_across(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Multiply vectors of the plane across: a_x b_y - a_y b_x, twice the area of the triangle that they span.

    Parameters
    ----------
    a, b : (..., 2) arrays
        Of shapes that broadcast.

    Returns
    -------
    (...,) array
        Positive where b lies to the side of +y from a along +x.
    """
    ax, ay = a[..., 0], a[..., 1]
    bx, by = b[..., 0], b[..., 1]
    return np.asarray(ax * by - ay * bx)


def build_tree(points: NDArray[np.float64]) -> cKDTree:
    """Build the tree that finds the nearest of some points, (n, 2)."""
    # Here, for it brings a tenth of a second of scipy's imports, and most ranks and many runs do without.
    from scipy.spatial import cKDTree

    return cKDTree(points)
