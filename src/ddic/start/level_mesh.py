"""The grid of a pyramid level with its unknowns, cut where a discontinuity crosses it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.line_band import find_band_pixels
from ddic.kinematics.discontinuities import Discontinuities
from ddic.kinematics.enriched import enrich
from ddic.kinematics.kinematics import RegionKinematics
from ddic.kinematics.nodal import NodalRegion
from ddic.mesh.cut_mesh import cut_mesh
from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import rasterize
from ddic.mesh.topology import find_boundary_nodes
from ddic.start.coarse_grid import Grid, locate_block_centre
from ddic.start.cut_field import CoarseField, CutField


@dataclass(frozen=True, eq=False)
class LevelMesh:
    """A level's cells and unknowns.

    Attributes
    ----------
    grid : Grid
        As it is where nothing cuts it, blocks.
    kinematics : RegionKinematics
        Its mesh, cut or not, and the unknowns, blocks.
    on_edge : (n_nodes,) array of bool
        Nodes of the grid's edge.
    interior : (n_nodes,) array of bool
        Nodes at which texture is weighed against mechanics.
    """

    grid: Grid
    kinematics: RegionKinematics
    on_edge: NDArray[np.bool_]
    interior: NDArray[np.bool_]

    @property
    def mesh(self) -> Mesh:
        """The cells, blocks."""
        return self.kinematics.mesh

    def make_field(self, displacement: NDArray[np.float64], factor: int) -> CoarseField:
        """Make a field of displacements of the nodes.

        Parameters
        ----------
        displacement : (mesh.n_dofs,) array
            Of the nodes, blocks.
        factor : int
            Side of a block, pixels.

        Returns
        -------
        GridField or CutField
            Pixels.
        """
        if self.mesh.parts is None:
            return self.grid.make_field(displacement, factor)
        return CutField(scale_to_pixels(self.mesh, factor), displacement.reshape(-1, self.mesh.dim) * factor)


def cut_grid(grid: Grid, discontinuities: Discontinuities, active: NDArray[np.uint8], degree: int) -> LevelMesh:
    """Cut a grid by discontinuities.

    Parameters
    ----------
    grid : Grid
        Blocks.
    discontinuities : Discontinuities
        Blocks; none of them need cross the grid.
    active : (rows, columns) array of uint8
        1 on the blocks that count.
    degree : int
        Of the spline between blocks.

    Returns
    -------
    LevelMesh
        With unknowns on both sides of the lines.
    """
    edge = find_boundary_nodes(grid.mesh)
    cut = cut_mesh(grid.mesh, discontinuities.lines)
    on_edge = np.isin(cut.node_of, edge)
    parts = cut.mesh.parts
    if parts is None:
        return LevelMesh(grid, NodalRegion(grid.mesh), on_edge, ~on_edge)
    raster = rasterize(cut.mesh)
    in_band, _ = find_band_pixels(cut.mesh, raster, degree)
    counted = active.copy()
    counted[in_band[:, 1], in_band[:, 0]] = 0
    kinematics = enrich(cut, raster.sum_by_cell(counted), discontinuities.openings)
    of_cut_cells = cut.mesh.cells[parts.cells]
    beside_line = np.isin(cut.node_of, cut.node_of[of_cut_cells[of_cut_cells >= 0]])
    return LevelMesh(grid, kinematics, on_edge, ~on_edge & ~beside_line)


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
    origin = locate_block_centre(factor)
    parts = mesh.parts
    if parts is not None:
        parts = replace(parts, corners=parts.corners * factor + origin)
    return replace(mesh, nodes=mesh.nodes * factor + origin, parts=parts)
