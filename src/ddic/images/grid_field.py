"""A displacement field on a regular grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage


@dataclass(frozen=True)
class GridField:
    """Displacement on a regular grid.

    Attributes
    ----------
    origin : (x, y)
        Position of node [0, 0], pixels.
    spacing : (x, y)
        Between neighbours, pixels.
    values : (rows, columns, 2) array
        Displacement, pixels.
    """

    origin: tuple[float, float]
    spacing: tuple[float, float]
    values: NDArray[np.float64]

    def at(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Interpolate between the grid's nodes, bilinearly; constant beyond its edge.

        Parameters
        ----------
        points : (n, 2) array
            Pixels.

        Returns
        -------
        (n, 2) array
            Displacement, pixels.
        """
        place = (points - np.asarray(self.origin)) / np.asarray(self.spacing)
        return np.stack([
            ndimage.map_coordinates(self.values[..., c], place[:, ::-1].T, order=1, mode="nearest")
            for c in range(2)
        ], axis=1)


def build_uniform_field(shift: tuple[float, float]) -> GridField:
    """Return a rigid translation as a field.

    Parameters
    ----------
    shift : (x, y)
        Pixels.

    Returns
    -------
    GridField
        Of one node.
    """
    return GridField((0.0, 0.0), (1.0, 1.0), np.array([[shift]], dtype=np.float64))


def fill_absent(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Give grid nodes that are nan the value of the nearest present one.

    Parameters
    ----------
    values : (rows, columns, 2) array
        Displacement, pixels.

    Returns
    -------
    (rows, columns, 2) array
        Without nan where any node is present.
    """
    absent = np.isnan(values[..., 0])
    if not absent.any():
        return values
    nearest = ndimage.distance_transform_edt(absent, return_distances=False, return_indices=True)
    return np.asarray(values[tuple(nearest)])
