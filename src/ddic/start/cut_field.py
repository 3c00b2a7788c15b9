"""A coarse displacement field that jumps across lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ddic.mesh.interpolation import interpolate_located, locate, place_in_cells
from ddic.mesh.mesh import Mesh
from ddic.mesh.own_side import find_points_on_own_side


@dataclass(frozen=True, eq=False)
class CutField:
    """Displacement on a mesh that discontinuities cut.

    Attributes
    ----------
    mesh : Mesh
        With its cut cells, pixels.
    displacement : (n_nodes, 2) array
        Pixels.
    """

    mesh: Mesh
    displacement: NDArray[np.float64]

    def interpolate_at_nodes(self, mesh: Mesh) -> NDArray[np.float64]:
        """Prolong the displacement to the nodes of another mesh, each on its own side of all lines.

        Parameters
        ----------
        mesh : Mesh
            Perhaps with cut cells, pixels.

        Returns
        -------
        (n_nodes, 2) array
            Displacement, pixels: that of the cell that holds a point on the node's side, extrapolated to the node;
            outside the mesh that of the nearest node.
        """
        on_own_side = find_points_on_own_side(mesh)
        cells = locate(self.mesh, on_own_side).cells
        is_held = cells >= 0
        values = interpolate_located(self.mesh, self.displacement, place_in_cells(self.mesh, cells, mesh.nodes))
        nearest = cKDTree(find_points_on_own_side(self.mesh)).query(on_own_side[~is_held])[1]
        values[~is_held] = self.displacement[nearest]
        return values

    def at(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Interpolate the displacement.

        Parameters
        ----------
        points : (n, 2) array
            Pixels.

        Returns
        -------
        (n, 2) array
            Displacement, pixels; outside the mesh that of the nearest node.
        """
        located = locate(self.mesh, points)
        values = interpolate_located(self.mesh, self.displacement, located)
        outside = located.cells < 0
        if outside.any():
            nearest = cKDTree(find_points_on_own_side(self.mesh)).query(points[outside])[1]
            values[outside] = self.displacement[nearest]
        return values
