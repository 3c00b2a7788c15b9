"""A grid of rectangles, and meshes of parts of it, each made by whoever needs it."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ddic.arrays import Array, IntArray
from ddic.mesh.cell_type import Q4
from ddic.mesh.mesh import Mesh, build_mesh
from ddic.mesh.raster import SNAP


class GridBlock(NamedTuple):
    """Some rectangles of a grid that together are one.

    Attributes
    ----------
    columns, rows : range
        Columns and rows of rectangles.
    """

    columns: range
    rows: range

    @property
    def n_cells(self) -> int:
        """Number of rectangles."""
        return len(self.columns) * len(self.rows)


class GridPart(NamedTuple):
    """The mesh of a block.

    Attributes
    ----------
    mesh : Mesh
        With the node sets of the grid's sides, as far as it has their nodes.
    node_ids, cell_ids : (n_nodes,) and (n_cells,) array of int64
        Numbers of its nodes and cells in the grid, row by row.
    """

    mesh: Mesh
    node_ids: IntArray
    cell_ids: IntArray


@dataclass(frozen=True)
class GridLines:
    """Lines of a rectangular grid.

    Attributes
    ----------
    x, y : (n_columns + 1,) and (n_rows + 1,) array
        Of the vertical and of the horizontal lines, pixels.
    """

    x: Array
    y: Array

    @property
    def n_cells(self) -> int:
        """Number of rectangles."""
        return (len(self.x) - 1) * (len(self.y) - 1)

    @property
    def n_nodes(self) -> int:
        """Number of crossings."""
        return len(self.x) * len(self.y)

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Where it lies: x0, y0, x1, y1, pixels."""
        return float(self.x[0]), float(self.y[0]), float(self.x[-1]), float(self.y[-1])

    @property
    def nodes(self) -> Array:
        """Crossings of the lines, row by row, ((n_rows + 1) (n_columns + 1), 2), pixels."""
        x, y = np.meshgrid(self.x, self.y)
        return np.column_stack([x.ravel(), y.ravel()])

    @property
    def quads(self) -> IntArray:
        """Nodes of the rectangles, row by row, (n_rows n_columns, 4)."""
        wide = len(self.x)
        rows, columns = np.meshgrid(np.arange(len(self.y) - 1), np.arange(wide - 1), indexing="ij")
        first = (rows * wide + columns).ravel()
        return np.column_stack([first, first + 1, first + wide + 1, first + wide]).astype(np.int64)

    @property
    def centroids(self) -> Array:
        """Centres of the rectangles, row by row, (n_rows n_columns, 2), pixels."""
        between_x = (self.x[1:] + self.x[:-1]) / 2
        between_y = (self.y[1:] + self.y[:-1]) / 2
        return GridLines(between_x, between_y).nodes

    @property
    def sides(self) -> dict[str, IntArray]:
        """Nodes on the sides; y points down, so that top is where y is smallest."""
        numbers = np.arange(len(self.x) * len(self.y), dtype=np.int64).reshape(len(self.y), len(self.x))
        return {"left": numbers[:, 0], "right": numbers[:, -1], "top": numbers[0], "bottom": numbers[-1]}

    def pad(self) -> "GridLines":
        """Put a ring of rectangles around."""
        x, y = (np.concatenate([[2 * lines[0] - lines[1]], lines, [2 * lines[-1] - lines[-2]]])
                for lines in (self.x, self.y))
        return GridLines(x, y)

    def build_mesh(self) -> Mesh:
        """Build the mesh of all rectangles, without node sets."""
        return build_mesh(self.nodes, {Q4: self.quads})

    def cut_block(self, block: GridBlock) -> GridPart:
        """Make the mesh of a block, as a mesh of the whole grid restricted to its cells would be."""
        columns, rows = (range(cells.start, cells.stop + 1) for cells in block)
        part = GridLines(self.x[columns.start:columns.stop], self.y[rows.start:rows.stop])
        on_grid = {"left": columns.start == 0, "right": columns.stop == len(self.x),
                   "top": rows.start == 0, "bottom": rows.stop == len(self.y)}
        sets = {name: nodes if on_grid[name] else nodes[:0] for name, nodes in part.sides.items()}
        mesh = replace(part.build_mesh(), node_sets=sets)
        return GridPart(mesh, _number(rows, columns, len(self.x)), _number(block.rows, block.columns, len(self.x) - 1))

    def count_pixels(self) -> tuple[IntArray, IntArray]:
        """Count the columns of pixels of each column of rectangles, and the rows of each row, as ``rasterize`` does."""
        columns, rows = np.ceil(np.round(self.x * SNAP) / SNAP), np.ceil(self.y)
        return np.diff(columns.astype(np.int64)), np.diff(rows.astype(np.int64))

    @property
    def cell_size(self) -> float:
        """Root of the rectangles' mean area, pixels."""
        return float(np.sqrt(np.ptp(self.x) * np.ptp(self.y) / self.n_cells))

    def build_outline(self) -> Mesh:
        """Build a mesh of one rectangle that covers the grid."""
        return GridLines(self.x[[0, -1]], self.y[[0, -1]]).cut_block(GridBlock(range(1), range(1))).mesh


def _number(rows: range, columns: range, wide: int) -> IntArray:
    """Numbers, row by row, in rows of so many."""
    return (np.arange(rows.start, rows.stop)[:, None] * wide + np.arange(columns.start, columns.stop)).ravel()
