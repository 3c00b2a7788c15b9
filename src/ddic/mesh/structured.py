"""Regular meshes of a rectangular region, with holes and masks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.mesh.cell_type import Q4, T3
from ddic.mesh.holes import CircularHole, Hole, PolygonalHole
from ddic.mesh.mesh import Mesh, mesh_from_cells
from ddic.mesh.snapping import chop_corners, snap_to_holes


@dataclass(frozen=True)
class Grid:
    """Lines of a rectangular grid, pixels: x (n_columns + 1,), y (n_rows + 1,)."""

    x: NDArray[np.float64]
    y: NDArray[np.float64]

    @property
    def nodes(self) -> NDArray[np.float64]:
        """Crossings of the lines, row by row, ((n_rows + 1) (n_columns + 1), 2), pixels."""
        x, y = np.meshgrid(self.x, self.y)
        return np.column_stack([x.ravel(), y.ravel()])

    @property
    def quads(self) -> NDArray[np.int64]:
        """Nodes of the rectangles, row by row, (n_rows n_columns, 4)."""
        wide = len(self.x)
        rows, columns = np.meshgrid(np.arange(len(self.y) - 1), np.arange(wide - 1), indexing="ij")
        first = (rows * wide + columns).ravel()
        return np.column_stack([first, first + 1, first + wide + 1, first + wide]).astype(np.int64)

    @property
    def centroids(self) -> NDArray[np.float64]:
        """Centres of the rectangles, row by row, (n_rows n_columns, 2), pixels."""
        return Grid((self.x[1:] + self.x[:-1]) / 2, (self.y[1:] + self.y[:-1]) / 2).nodes


def structured_mesh(region: Sequence[float], element_size: float, cell: Literal["Q4", "T3"] = "Q4",
                    circles: Sequence[tuple[tuple[float, float], float]] = (),
                    polygons: Sequence[NDArray[np.float64]] = (),
                    mask: NDArray[np.bool_] | None = None) -> Mesh:
    """Mesh a rectangle by regular cells that cover it exactly.

    region: (x0, y0, x1, y1), pixels. element_size: pixels; there are round(side / element_size) cells
    along a side, at least one, so that cells are stretched slightly where the size does not divide the
    side. cell: Q4, or T3 with alternating diagonals. circles: (centre, radius), pixels.
    polygons: vertices (n, 2), pixels. mask: (height, width), True where cells may be; a cell is kept if
    at least half of its pixels are.

    A cell is removed if its centre lies in a hole, then the nodes around the hole are moved onto its
    outline; where the hole meets a cell at a corner, that corner is cut off, so that a Q4 mesh with holes
    holds some T3. Node sets: left, right, top, bottom (of the region), and hole_0, hole_1, ... (circles,
    then polygons). Raises InputError where a hole removes no cell, or where no cell is left.
    """
    grid = _grid(region, element_size)
    holes: list[Hole] = [CircularHole(center, radius) for center, radius in circles]
    holes += [PolygonalHole(np.asarray(vertices, dtype=np.float64)) for vertices in polygons]
    inside = np.array([_cells_in_hole(grid, hole, k) for k, hole in enumerate(holes)])
    drilled = inside.any(axis=0) if holes else np.zeros(len(grid.quads), dtype=bool)
    drilled |= False if mask is None else ~_cells_in_mask(grid, mask)
    if drilled.all():
        raise InputError("mesh.structured: no cell is left; holes and mask cover the whole region")
    nodes, quads = grid.nodes, grid.quads
    members = [np.unique(quads[~drilled][np.isin(quads[~drilled], quads[cells])]) for cells in inside]
    quads, triangles = chop_corners(quads[~drilled], members, nodes, holes)
    if cell == "T3":
        quads, triangles = quads[:0], np.concatenate([_split_quads(quads, len(grid.x)), triangles])
    # After the split, so that the cells whose shape is watched are those of the mesh.
    nodes, on_holes = snap_to_holes(nodes, quads, triangles, members, holes, region)
    blocks = {Q4: quads, T3: triangles}
    mesh = mesh_from_cells(nodes, {kind: block for kind, block in blocks.items() if len(block)},
                           _sides(grid) | {f"hole_{k}": found for k, found in enumerate(on_holes)})
    return mesh.submesh(np.arange(mesh.n_cells))[0]


def _grid(region: Sequence[float], element_size: float) -> Grid:
    x0, y0, x1, y1 = region
    lines = [np.linspace(low, high, max(1, round((high - low) / element_size)) + 1)
             for low, high in ((x0, x1), (y0, y1))]
    return Grid(lines[0], lines[1])


def _cells_in_hole(grid: Grid, hole: Hole, number: int) -> NDArray[np.bool_]:
    inside = hole.distance(grid.centroids) < 0
    if not inside.any():
        raise InputError(f"mesh.structured: hole_{number} holds the centre of no cell: it lies outside the "
                         "region, or is too small for element_size; leave it out or use smaller elements")
    return np.asarray(inside)


def _cells_in_mask(grid: Grid, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Cells with at least half of their pixel centres in the mask; outside of it counts as False."""
    width = mask.shape[1]
    # Half-open cells, x <= centre < x', give every pixel centre to exactly one cell.
    columns, rows = np.ceil(grid.x).astype(np.int64), np.ceil(grid.y).astype(np.int64)
    clipped = np.clip(columns, 0, width)
    kept = np.empty((len(rows) - 1, len(columns) - 1), dtype=bool)
    for k, (top, bottom) in enumerate(pairwise(rows)):
        strip = mask[max(top, 0):max(bottom, 0)].sum(axis=0)
        sums = np.concatenate([[0], np.cumsum(strip)])[clipped]
        kept[k] = 2 * np.diff(sums) >= np.diff(columns) * (bottom - top)
    return kept.ravel()


def _split_quads(quads: NDArray[np.int64], wide: int) -> NDArray[np.int64]:
    """Split rectangles into triangles; the diagonals alternate like the fields of a chessboard."""
    row, column = np.divmod(quads[:, 0], wide)
    turned = np.where(((row + column) % 2 == 0)[:, None], quads, np.roll(quads, -1, axis=1))
    return turned[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)


def _sides(grid: Grid) -> dict[str, NDArray[np.int64]]:
    """Nodes on the sides of the region; y points down, so that top is where y is smallest."""
    numbers = np.arange(len(grid.x) * len(grid.y), dtype=np.int64).reshape(len(grid.y), len(grid.x))
    return {"left": numbers[:, 0], "right": numbers[:, -1], "top": numbers[0], "bottom": numbers[-1]}
