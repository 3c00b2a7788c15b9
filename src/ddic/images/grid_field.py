"""A displacement field on a regular grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage


@dataclass(frozen=True)
class GridField:
    """Displacement on a regular grid.

    origin: position of node [0, 0], pixels; spacing: (x, y), pixels; values: (rows, columns, 2), pixels.
    """

    origin: tuple[float, float]
    spacing: tuple[float, float]
    values: NDArray[np.float64]

    def at(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Bilinear interpolation at points (n, 2), constant beyond the grid's edge; returns (n, 2)."""
        place = (points - np.asarray(self.origin)) / np.asarray(self.spacing)
        return np.stack([
            ndimage.map_coordinates(self.values[..., c], place[:, ::-1].T, order=1, mode="nearest")
            for c in range(2)
        ], axis=1)


def uniform_field(shift: tuple[float, float]) -> GridField:
    """A rigid translation (x, y), pixels, as a field."""
    return GridField((0.0, 0.0), (1.0, 1.0), np.array([[shift]], dtype=np.float64))


def fill_absent(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Give grid nodes that are NaN the value of the nearest present one; values (rows, columns, 2)."""
    absent = np.isnan(values[..., 0])
    if not absent.any():
        return values
    nearest = ndimage.distance_transform_edt(absent, return_distances=False, return_indices=True)
    return np.asarray(values[tuple(nearest)])
