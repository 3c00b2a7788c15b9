"""What the start finds, a displacement at any node: on cells that a line may cut, where the field may jump."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, BoolArray
from ddic.functionals.line_band import weigh_corners
from ddic.images.rigid import GridField
from ddic.kinematics.enriched import Discontinuities, enrich
from ddic.kinematics.kinematics import RegionKinematics
from ddic.kinematics.nodal import NodalRegion
from ddic.mesh.cut_mesh import CutMesh, cut_mesh, find_points_on_own_side
from ddic.mesh.interpolation import interpolate_located, locate, place_in_cells
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import build_tree
from ddic.mesh.topology import find_boundary_nodes
from ddic.start.binned_pair import move_mesh
from ddic.start.feature_matches import MatchedField


@dataclass(frozen=True, eq=False)
class LevelMesh:
    """Cells with their unknowns, for one rank to correlate by itself.

    Attributes
    ----------
    cut : CutMesh
        The cells and what they are parts of, blocks.
    kinematics : RegionKinematics
        Their mesh, cut or not, and the unknowns, blocks.
    on_edge, interior : (n_nodes,) array of bool
        Nodes of the edge, and those at which texture is weighed against mechanics.
    """

    cut: CutMesh
    kinematics: RegionKinematics
    on_edge: BoolArray
    interior: BoolArray

    @property
    def mesh(self) -> Mesh:
        """The cells, blocks."""
        return self.kinematics.mesh


def cut_level(mesh: Mesh, discontinuities: Discontinuities, active: NDArray[np.uint8], degree: int) -> LevelMesh:
    """Cut cells by discontinuities, both in blocks, with unknowns on both sides of the lines.

    None of the lines need cross the mesh. ``active``, (rows, columns), is 1 on the blocks that count; ``degree`` is
    that of the spline between blocks.
    """
    cut = cut_mesh(mesh, discontinuities.lines)
    on_edge = np.zeros(cut.mesh.n_nodes, dtype=bool)
    on_edge[cut.find_with_phantoms(find_boundary_nodes(mesh))] = True
    interior = ~on_edge
    interior[cut.find_with_phantoms(cut.node_of[cut.find_cut_nodes()])] = False
    if cut.mesh.parts is None:
        return LevelMesh(cut, NodalRegion(mesh), on_edge, interior)
    weights = weigh_corners(cut.mesh, cut.find_cells_at_phantoms(), degree, active)
    kinematics = enrich(cut, weights, discontinuities.openings)
    return LevelMesh(cut, kinematics, on_edge, interior)


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
    displacement: Array

    def interpolate_at_nodes(self, mesh: Mesh) -> Array:
        """Prolong the displacement to nodes of another mesh, (n_nodes, 2), pixels, each on its own side of all lines.

        It is that of the cell that holds a point on the node's side, extrapolated to the node; outside the mesh that of
        the nearest node.
        """
        on_own_side = find_points_on_own_side(mesh)
        cells = locate(self.mesh, on_own_side).cells
        values = interpolate_located(self.mesh, self.displacement, place_in_cells(self.mesh, cells, mesh.nodes))
        return self._extend(values, on_own_side, cells < 0)

    def at(self, points: Array) -> Array:
        """Interpolate the displacement at points, (n, 2), pixels; outside the mesh it is that of the nearest node."""
        located = locate(self.mesh, points)
        return self._extend(interpolate_located(self.mesh, self.displacement, located), points, located.cells < 0)

    def _extend(self, values: Array, points: Array, outside: BoolArray) -> Array:
        """The values at points, (n, 2), those outside the mesh replaced by the nearest node's."""
        if outside.any():
            nearest = build_tree(find_points_on_own_side(self.mesh)).query(points[outside])[1]
            values[outside] = self.displacement[nearest]
        return values


@dataclass(frozen=True, eq=False)
class MovedField:
    """What was found in parts of both images that begin at other places.

    Attributes
    ----------
    field : CutField, MatchedField or MovedField
        Pixels of these parts.
    origin, translation : (dim,) array
        Where the reference image's part begins, and where the deformed image's part begins from there, pixels.
    """

    field: CutField | MatchedField | MovedField
    origin: Array
    translation: Array

    def at(self, points: Array) -> Array:
        """Evaluate the displacement at points, (n, 2), pixels."""
        return np.asarray(self.field.at(points - self.origin) + self.translation)

    def interpolate_at_nodes(self, mesh: Mesh) -> Array:
        """Evaluate the displacement at the nodes of a mesh, perhaps with cut cells, (n_nodes, 2), pixels."""
        return self.field.interpolate_at_nodes(move_mesh(mesh, -self.origin)) + self.translation


CoarseField = GridField | CutField | MatchedField | MovedField


@dataclass(frozen=True, eq=False)
class KeptResult:
    """An earlier result's displacement, taken as it is.

    Attributes
    ----------
    beyond : CutField or None
        What extends it, on the cells that the earlier mesh does not hold whole; None where there are none.
    """

    beyond: CutField | None


def move_field(field: CoarseField, origin: Array, translation: Array) -> CoarseField:
    """Give what was found in parts of both images in pixels of the images.

    The reference image's part begins at ``origin``, the deformed image's part from there at ``translation``,
    (dim,), pixels.
    """
    if not isinstance(field, GridField):
        return MovedField(field, origin, translation)
    return GridField(tuple((field.origin + origin).tolist()), field.spacing, field.values + translation)


def evaluate_at_nodes(field: CoarseField, mesh: Mesh) -> Array:
    """Evaluate a coarse field at the nodes of a mesh, perhaps with cut cells, (n_nodes, 2), pixels."""
    return field.at(mesh.nodes) if isinstance(field, GridField) else field.interpolate_at_nodes(mesh)
