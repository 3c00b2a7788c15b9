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
from ddic.mesh.mask_outline import OutlinedHole
from ddic.mesh.mesh import Mesh, build_mesh
from ddic.mesh.snapping import chop_corners, snap_to_holes

MOST_CELLS = 1e9
"""Cells of a mesh: more than any image has pixels, and fewer than overflow a count."""


@dataclass(frozen=True)
class Grid:
    """Lines of a rectangular grid.

    Attributes
    ----------
    x : (n_columns + 1,) array
        Of the vertical lines, pixels.
    y : (n_rows + 1,) array
        Of the horizontal lines, pixels.
    """

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
        between_x = (self.x[1:] + self.x[:-1]) / 2
        between_y = (self.y[1:] + self.y[:-1]) / 2
        return Grid(between_x, between_y).nodes

    @property
    def sides(self) -> dict[str, NDArray[np.int64]]:
        """Nodes on the sides; y points down, so that top is where y is smallest."""
        numbers = np.arange(len(self.x) * len(self.y), dtype=np.int64).reshape(len(self.y), len(self.x))
        return {"left": numbers[:, 0], "right": numbers[:, -1], "top": numbers[0], "bottom": numbers[-1]}


def build_structured_mesh(region: Sequence[float], element_size: float, cell: Literal["Q4", "T3"] = "Q4",
                    circles: Sequence[tuple[tuple[float, float], float]] = (),
                    polygons: Sequence[NDArray[np.float64] | OutlinedHole] = (),
                    mask: NDArray[np.bool_] | None = None) -> Mesh:
    """Mesh a rectangle by regular cells that cover it exactly.

    A cell is removed if its centre lies in a hole, then the nodes around the hole are moved onto its outline; where the
    hole meets a cell at a corner, that corner is cut off, so that a Q4 mesh with holes holds some T3.

    Parameters
    ----------
    region : (x0, y0, x1, y1)
        Pixels.
    element_size : float
        Pixels; there are round(side / element_size) cells along a side, at least one, so that cells are stretched
        slightly where the size does not divide the side.
    cell : {"Q4", "T3"}
        T3 with alternating diagonals.
    circles : sequence of (centre, radius)
        Round holes, pixels.
    polygons : sequence of (n, 2) arrays or OutlinedHole
        Vertices of other holes, pixels; what ``find_mask_holes`` finds in a mask.
    mask : (height, width) bool array, optional
        True where cells may be; a cell is kept if at least half of its pixels are.

    Returns
    -------
    Mesh
        With node sets left, right, top, bottom (of the region), and hole_0, hole_1, ... (circles, then polygons).

    Raises
    ------
    InputError
        Where an argument is impossible, a hole removes no cell, or no cell is left.
    """
    _refuse_impossible(region, element_size, cell, mask)
    grid = _fit_grid(region, element_size)
    holes: list[Hole] = [CircularHole(center, radius) for center, radius in circles]
    holes += [outline if isinstance(outline, OutlinedHole) else PolygonalHole(np.asarray(outline, dtype=np.float64))
              for outline in polygons]
    in_holes = [_cells_in_hole(grid, hole, k) for k, hole in enumerate(holes)]
    kept = _kept_cells(grid, in_holes, mask)
    members = [np.intersect1d(grid.quads[kept], grid.quads[inside]) for inside in in_holes]
    quads, triangles = chop_corners(grid.quads[kept], members, grid.nodes, holes)
    if cell == "T3":
        halves = _split_quads(quads, len(grid.x))
        quads, triangles = quads[:0], np.concatenate([halves, triangles])
    # After the split, so that the cells whose shape is watched are those of the mesh.
    nodes, on_holes = snap_to_holes(grid.nodes, quads, triangles, members, holes, region)
    sets = grid.sides | {f"hole_{k}": found for k, found in enumerate(on_holes)}
    mesh = build_mesh(nodes, {Q4: quads, T3: triangles}, sets)
    # Without the nodes that no cell uses any more.
    return mesh.create_submesh(np.arange(mesh.n_cells))[0]


def _refuse_impossible(region: Sequence[float], element_size: float, cell: str,
                       mask: NDArray[np.bool_] | None) -> None:
    """Refuse arguments of which no mesh can be made; case files say them with types and ranges of their own."""
    given = f"mesh.structured: region = {region}, element_size = {element_size}"
    numbers = np.asarray([*region, element_size])
    if len(region) != 4 or numbers.dtype.kind not in "iuf" or not np.isfinite(numbers).all():
        raise InputError(f"{given}: expected (x0, y0, x1, y1) and a size, finite numbers of pixels")
    if not (region[0] < region[2] and region[1] < region[3] and element_size > 0):
        raise InputError(f"{given}: expected x0 < x1, y0 < y1 and a size above 0")
    if cell not in ("Q4", "T3"):
        raise InputError(f'mesh.structured: cell = "{cell}": expected "Q4" or "T3"')
    if mask is not None and np.ndim(mask) != 2:
        raise InputError(f"mesh.structured: a mask of shape {np.shape(mask)}, (height, width) expected")


def count_cells(region: Sequence[float], element_size: float) -> tuple[int, int]:
    """Count the cells that cover a region, before there are any.

    Parameters
    ----------
    region : (x0, y0, x1, y1)
        Pixels.
    element_size : float
        Pixels.

    Returns
    -------
    n_columns, n_rows : int
        At least one each.

    Raises
    ------
    InputError
        Where there are more than MOST_CELLS in all.
    """
    x0, y0, x1, y1 = (float(side) for side in region)
    with np.errstate(over="ignore"):
        along = np.array([x1 - x0, y1 - y0]) / element_size
        n_cells = np.maximum(along, 1.0).prod()
    if not n_cells <= MOST_CELLS:
        raise InputError(f"mesh.structured: element_size = {element_size:g} on region = [{x0:g}, {y0:g}, {x1:g}, "
                         f"{y1:g}] asks for {n_cells:.3g} elements, more than {MOST_CELLS:.0e}; give larger elements, "
                         "in pixels")
    n_columns, n_rows = (max(1, round(float(sides))) for sides in along)
    return n_columns, n_rows


def _fit_grid(region: Sequence[float], element_size: float) -> Grid:
    """Lines that divide the region evenly."""
    x0, y0, x1, y1 = region
    n_columns, n_rows = count_cells(region, element_size)
    return Grid(np.linspace(x0, x1, n_columns + 1), np.linspace(y0, y1, n_rows + 1))


def _kept_cells(grid: Grid, in_holes: Sequence[NDArray[np.bool_]],
                mask: NDArray[np.bool_] | None) -> NDArray[np.bool_]:
    """Cells in no hole and in the mask."""
    kept = np.ones(len(grid.quads), dtype=bool)
    for inside in in_holes:
        kept &= ~inside
    if mask is not None:
        kept &= _cells_in_mask(grid, np.asarray(mask) != 0)
    if not kept.any():
        raise InputError("mesh.structured: no cell is left; holes and mask cover the whole region")
    return kept


def _cells_in_hole(grid: Grid, hole: Hole, number: int) -> NDArray[np.bool_]:
    """Cells whose centres lie in a hole."""
    inside = hole.measure_distance(grid.centroids) < 0
    # What a mask leaves out may be smaller than a cell; a hole that was asked for may not.
    if not inside.any() and not isinstance(hole, OutlinedHole):
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
        in_column = mask[max(top, 0):max(bottom, 0)].sum(axis=0)
        up_to = np.concatenate([[0], np.cumsum(in_column)])
        in_cell = np.diff(up_to[clipped])
        n_pixels = np.diff(columns) * (bottom - top)
        kept[k] = 2 * in_cell >= n_pixels
    return kept.ravel()


def _split_quads(quads: NDArray[np.int64], wide: int) -> NDArray[np.int64]:
    """Split rectangles into triangles; the diagonals alternate like the fields of a chessboard."""
    row, column = np.divmod(quads[:, 0], wide)
    even = (row + column) % 2 == 0
    turned = np.where(even[:, None], quads, np.roll(quads, -1, axis=1))
    halves = turned[:, [0, 1, 2, 0, 2, 3]]
    return halves.reshape(-1, 3)
