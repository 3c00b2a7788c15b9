"""A grid of rectangles, or of boxes in a volume, and meshes of parts of it, each made by whoever needs it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import prod
from typing import NamedTuple

import numpy as np

from ddic.arrays import Array, IntArray
from ddic.mesh.cell_type import HEX8, Q4, CellType
from ddic.mesh.mesh import Mesh, build_mesh
from ddic.mesh.raster import SNAP

SIDES = (("left", "right"), ("top", "bottom"), ("front", "back"))
"""Names of the sides where x, y and z are smallest and largest; y points down."""


class GridBlock(NamedTuple):
    """Some cells of a grid that together are a box.

    Attributes
    ----------
    ranges : tuple of range
        Columns, rows and planes of cells.
    """

    ranges: tuple[range, ...]

    @property
    def n_cells(self) -> int:
        """Number of cells."""
        return prod(map(len, self.ranges))


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
    lines : tuple of (n + 1,) array
        Where n cells along x, along y and along z begin and end, pixels.
    """

    lines: tuple[Array, ...]

    @property
    def dim(self) -> int:
        """Number of space dimensions."""
        return len(self.lines)

    @property
    def cell_type(self) -> CellType:
        """Of its cells."""
        return Q4 if self.dim == 2 else HEX8

    @property
    def n_along(self) -> tuple[int, ...]:
        """Number of cells along each axis."""
        return tuple(len(line) - 1 for line in self.lines)

    @property
    def n_cells(self) -> int:
        """Number of cells."""
        return prod(self.n_along)

    @property
    def n_nodes(self) -> int:
        """Number of crossings."""
        return prod(map(len, self.lines))

    @property
    def box(self) -> tuple[float, ...]:
        """Where it lies: its lowest corner, then its highest, pixels."""
        return *(float(line[0]) for line in self.lines), *(float(line[-1]) for line in self.lines)

    @property
    def nodes(self) -> Array:
        """Crossings of the lines, row by row, (n_nodes, dim), pixels."""
        # The last axis varies slowest.
        return np.column_stack([along.ravel() for along in np.meshgrid(*self.lines[::-1], indexing="ij")[::-1]])

    @property
    def cells(self) -> IntArray:
        """Nodes of the cells, row by row, (n_cells, n_nodes of a cell)."""
        steps = np.cumprod([1, *map(len, self.lines[:-1])])
        first = _number([range(n) for n in self.n_along], list(map(len, self.lines)))
        # Reference nodes have coordinates -1 and 1.
        to_corners = (self.cell_type.nodes > 0) @ steps
        return np.asarray(first[:, None] + to_corners, dtype=np.int64)

    @property
    def centroids(self) -> Array:
        """Centres of the cells, row by row, (n_cells, dim), pixels."""
        return GridLines(tuple((line[1:] + line[:-1]) / 2 for line in self.lines)).nodes

    @property
    def sides(self) -> dict[str, IntArray]:
        """Nodes on the sides; y points down, so that top is where y is smallest."""
        shape = tuple(map(len, self.lines))[::-1]
        numbers = np.arange(self.n_nodes, dtype=np.int64).reshape(shape)
        return {name: np.take(numbers, end, axis=-1 - axis).ravel()
                for axis, names in enumerate(SIDES[:self.dim]) for name, end in zip(names, (0, -1), strict=True)}

    def pad(self) -> "GridLines":
        """Put a ring of cells around."""
        return GridLines(tuple(np.concatenate([[2 * line[0] - line[1]], line, [2 * line[-1] - line[-2]]])
                               for line in self.lines))

    def build_mesh(self) -> Mesh:
        """Build the mesh of all cells, without node sets."""
        return build_mesh(self.nodes, {self.cell_type: self.cells})

    def cut_block(self, block: GridBlock) -> GridPart:
        """Make the mesh of a block, as a mesh of the whole grid restricted to its cells would be."""
        of_nodes = [range(cells.start, cells.stop + 1) for cells in block.ranges]
        part = GridLines(tuple(line[some.start:some.stop] for line, some in zip(self.lines, of_nodes, strict=True)))
        on_grid = {name: is_there for names, some, line in zip(SIDES, of_nodes, self.lines, strict=False)
                   for name, is_there in zip(names, (some.start == 0, some.stop == len(line)), strict=True)}
        sets = {name: nodes if on_grid[name] else nodes[:0] for name, nodes in part.sides.items()}
        mesh = replace(part.build_mesh(), node_sets=sets)
        return GridPart(mesh, _number(of_nodes, list(map(len, self.lines))), _number(block.ranges, self.n_along))

    def count_pixels(self) -> list[IntArray]:
        """Count the pixels of each cell along each axis, as ``rasterize`` does."""
        # Columns are where rows cross the sides; in a volume all nodes are rounded.
        rounded = [np.round(line * SNAP) / SNAP for line in self.lines]
        ends = [rounded[0], self.lines[1]] if self.dim == 2 else rounded
        return [np.diff(np.ceil(of_line).astype(np.int64)) for of_line in ends]

    @property
    def cell_size(self) -> float:
        """Side of a square, or cube, like the cells' mean, pixels."""
        return float((prod(float(np.ptp(line)) for line in self.lines) / self.n_cells) ** (1 / self.dim))

    def build_outline(self) -> Mesh:
        """Build a mesh of one cell that covers the grid."""
        whole = GridLines(tuple(line[[0, -1]] for line in self.lines))
        return whole.cut_block(GridBlock((range(1),) * self.dim)).mesh


def _number(ranges: Sequence[range], sizes: Sequence[int]) -> IntArray:
    """Numbers of some places in a box, row by row."""
    steps = np.cumprod([1, *sizes[:-1]])
    numbers = np.zeros(1, dtype=np.int64)
    for some, step in zip(ranges[::-1], steps[::-1], strict=True):
        numbers = numbers[..., None] + step * np.arange(some.start, some.stop)
    return numbers.ravel()
