"""The square grid on which a level of the pyramid measures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.images.grid_field import GridField, fill_absent
from ddic.mesh.cell_type import Q4
from ddic.mesh.mesh import Mesh, build_mesh
from ddic.mesh.raster import rasterize

CELL = 16
"""Side of the grid's cells, blocks. A larger value gives smoother fields, found more surely."""


@dataclass(frozen=True)
class Grid:
    """Square cells that hold active blocks, within a regular grid over the region's bounding box.

    Attributes
    ----------
    mesh : Mesh
        The cells, blocks.
    numbers : (mesh.n_nodes,) array of int64
        Numbers of its nodes in the full grid, row after row.
    shape : (rows, columns)
        Nodes of the full grid.
    origin : (2,) array
        Its first node, blocks.
    spacing : (2,) array
        Between its nodes, blocks.
    """

    mesh: Mesh
    numbers: NDArray[np.int64]
    shape: tuple[int, int]
    origin: NDArray[np.float64]
    spacing: NDArray[np.float64]

    def make_field(self, displacement: NDArray[np.float64], factor: int) -> GridField:
        """Make a field of displacements of the cells' nodes.

        Parameters
        ----------
        displacement : (mesh.n_dofs,) array
            Of the nodes, blocks.
        factor : int
            Side of a block, pixels.

        Returns
        -------
        GridField
            On the full grid, pixels; nodes without a cell have the nearest node's value.
        """
        values = np.full((*self.shape, 2), np.nan)
        values.reshape(-1, 2)[self.numbers] = displacement.reshape(-1, 2) * factor
        x0, y0 = self.origin * factor + locate_block_centre(factor)
        step_x, step_y = self.spacing * factor
        return GridField((x0, y0), (step_x, step_y), fill_absent(values))


def locate_block_centre(factor: int) -> float:
    """Find the position of the first block's centre.

    Parameters
    ----------
    factor : int
        Side of a block, pixels.

    Returns
    -------
    float
        Along either axis, pixels.
    """
    return (factor - 1) / 2


def build_grid(region: Mesh, active: NDArray[np.uint8]) -> Grid:
    """Build a grid over a region, without the cells that have no active block.

    Parameters
    ----------
    region : Mesh
        What is measured, blocks.
    active : (rows, columns) array of uint8
        1 on the blocks that count.

    Returns
    -------
    Grid
        Of cells with a side of about ``CELL`` blocks.
    """
    # Pixels that fill no block may lie beyond the last one's edge.
    n_rows_of_blocks, n_columns_of_blocks = active.shape
    edge = np.array([n_columns_of_blocks, n_rows_of_blocks]) - 0.5
    low, high = np.maximum(region.nodes.min(axis=0), -0.5), np.minimum(region.nodes.max(axis=0), edge)
    n_columns, n_rows = np.maximum(np.round((high - low) / CELL).astype(int), 1)
    xs = np.linspace(low[0], high[0], n_columns + 1)
    ys = np.linspace(low[1], high[1], n_rows + 1)
    all_x, all_y = np.meshgrid(xs, ys)
    nodes = np.stack([all_x.ravel(), all_y.ravel()], axis=1)
    full = build_mesh(nodes, {Q4: _connect(n_rows, n_columns)})

    n_active = rasterize(full).sum_by_cell(active)
    mesh, numbers = full.create_submesh(np.flatnonzero(n_active > 0))
    shape = (int(n_rows) + 1, int(n_columns) + 1)
    spacing = (high - low) / (n_columns, n_rows)
    return Grid(mesh, numbers, shape, low, spacing)


def _connect(n_rows: int, n_columns: int) -> NDArray[np.int64]:
    """Nodes of each cell of a full grid, (n_cells, 4)."""
    nodes_a_row = n_columns + 1
    rows, columns = np.divmod(np.arange(n_rows * n_columns), n_columns)
    corner = rows * nodes_a_row + columns
    below = corner + nodes_a_row
    return np.stack([corner, corner + 1, below + 1, below], axis=1)
