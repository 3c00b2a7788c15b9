"""Cells with their unknowns, cut where a discontinuity crosses them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.corner_weights import weigh_corners
from ddic.kinematics.discontinuities import Discontinuities
from ddic.kinematics.enriched import enrich
from ddic.kinematics.kinematics import RegionKinematics
from ddic.kinematics.nodal import NodalRegion
from ddic.mesh.cell_parts import Lines
from ddic.mesh.cut_mesh import CutMesh, cut_mesh
from ddic.mesh.mesh import Mesh
from ddic.mesh.topology import find_boundary_nodes
from ddic.start.coarse_grid import locate_block_centre


@dataclass(frozen=True, eq=False)
class LevelMesh:
    """Cells with their unknowns, for one rank to correlate by itself.

    Attributes
    ----------
    cut : CutMesh
        The cells and what they are parts of, blocks.
    kinematics : RegionKinematics
        Their mesh, cut or not, and the unknowns, blocks.
    on_edge : (n_nodes,) array of bool
        Nodes of the edge.
    interior : (n_nodes,) array of bool
        Nodes at which texture is weighed against mechanics.
    """

    cut: CutMesh
    kinematics: RegionKinematics
    on_edge: NDArray[np.bool_]
    interior: NDArray[np.bool_]

    @property
    def mesh(self) -> Mesh:
        """The cells, blocks."""
        return self.kinematics.mesh


def cut_level(mesh: Mesh, discontinuities: Discontinuities, active: NDArray[np.uint8], degree: int) -> LevelMesh:
    """Cut cells by discontinuities.

    Parameters
    ----------
    mesh : Mesh
        Blocks.
    discontinuities : Discontinuities
        Blocks; none of them need cross the mesh.
    active : (rows, columns) array of uint8
        1 on the blocks that count.
    degree : int
        Of the spline between blocks.

    Returns
    -------
    LevelMesh
        With unknowns on both sides of the lines.
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


def scale_to_pixels(mesh: Mesh, factor: int) -> Mesh:
    """Give a mesh in blocks, perhaps cut, in pixels.

    Parameters
    ----------
    mesh : Mesh
        Blocks.
    factor : int
        Side of a block, pixels.

    Returns
    -------
    Mesh
        The same cells, pixels.
    """
    return _map_mesh(mesh, factor, locate_block_centre(factor))


def move_mesh(mesh: Mesh, vector: NDArray[np.float64]) -> Mesh:
    """Give a mesh, perhaps cut, at another place.

    Parameters
    ----------
    mesh : Mesh
        Pixels.
    vector : (2,) array
        By which it is moved, pixels.

    Returns
    -------
    Mesh
        The same cells, pixels.
    """
    return _map_mesh(mesh, 1, vector)


def _map_mesh(mesh: Mesh, factor: int, origin: float | NDArray[np.float64]) -> Mesh:
    """The same cells, all points times a factor and then moved."""
    parts = mesh.parts
    if parts is not None:
        lines = Lines(tuple(line * factor + origin for line in parts.lines.polylines),
                      tuple(bend * factor + origin for bend in parts.lines.bends))
        parts = replace(parts, corners=parts.corners * factor + origin, lines=lines)
    return replace(mesh, nodes=mesh.nodes * factor + origin, parts=parts)
