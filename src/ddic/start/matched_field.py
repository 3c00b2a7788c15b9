"""A coarse displacement field between places that were found again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ddic.mesh.interpolation import locate
from ddic.mesh.mesh import Mesh
from ddic.mesh.own_side import find_points_on_own_side
from ddic.start.feature_matches import FeatureMatches
from ddic.start.local_affine import N_NEIGHBOURS, fit_robustly

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MatchedField:
    """Displacement by affine maps of the nearest matches, each piece of the region for itself.

    Attributes
    ----------
    matches : FeatureMatches
        At least one.
    mesh : Mesh
        The region, perhaps cut by lines, pixels.
    piece_of_cell : (n_cells,) array of int64
        Piece of the region that each cell is of.
    """

    matches: FeatureMatches
    mesh: Mesh
    piece_of_cell: NDArray[np.int64]

    def interpolate_at_nodes(self, mesh: Mesh) -> Array:
        """Interpolate the displacement at the nodes of a mesh, each in the piece that it belongs to.

        Parameters
        ----------
        mesh : Mesh
            Perhaps with cut cells, pixels.

        Returns
        -------
        (n_nodes, 2) array
            Displacement, pixels; beyond the region that of the piece of the nearest match.
        """
        return self._interpolate(mesh.nodes, find_points_on_own_side(mesh))

    def at(self, points: Array) -> Array:
        """Interpolate the displacement.

        Parameters
        ----------
        points : (n, 2) array
            Pixels.

        Returns
        -------
        (n, 2) array
            Displacement, pixels; beyond the region that of the piece of the nearest match.
        """
        return self._interpolate(points, points)

    def _interpolate(self, points: Array, on_own_side: Array) -> Array:
        """Displacement of points, each in the piece that a point on its own side lies in."""
        cells = locate(self.mesh, on_own_side).cells
        nearest = cKDTree(self.matches.points).query(on_own_side)[1]
        pieces = np.where(cells >= 0, self.piece_of_cell[cells], self.matches.pieces[nearest])
        # A piece in which nothing was found moves with what is next to it.
        pieces = np.where(np.isin(pieces, self.matches.pieces), pieces, self.matches.pieces[nearest])
        values = np.empty(points.shape)
        for piece in np.unique(pieces):
            wanted, own = np.flatnonzero(pieces == piece), np.flatnonzero(self.matches.pieces == piece)
            n_neighbours = min(N_NEIGHBOURS, len(own))
            tree = cKDTree(self.matches.points[own])
            near = own[tree.query(points[wanted], list(range(1, n_neighbours + 1)))[1]]
            offsets = self.matches.points[near] - points[wanted, None]
            values[wanted] = fit_robustly(offsets, self.matches.displacement[near])
        return values
