"""Regular meshes of a rectangle, with holes and masks, along whose outlines the staircase of cells is rounded."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Literal

import numpy as np

from ddic.arrays import Array, BoolArray, IntArray
from ddic.errors import InputError
from ddic.mesh.cell_type import Q4, T3
from ddic.mesh.grid import GridLines
from ddic.mesh.holes import CircularHole, Hole, OutlinedHole, PolygonalHole
from ddic.mesh.mesh import Mesh, build_mesh
from ddic.mesh.quality import measure_shape_quality

SMALLEST_SINE = 0.2
"""Sine of the sharpest or flattest corner (12 or 168 degrees) that moving a node may cause. A larger value keeps better
cells and a rougher outline."""

SMALLEST_FRACTION = 0.25
"""Share of its way to the outline below which a node that is held back stays where it was."""

MOST_CANDIDATES = 4
"""Nodes near a corner of a hole, one of which is brought there; a larger value may take one from farther off."""

BISECTIONS = 50
"""Steps that find where a side meets an outline, each of which halves the error: 50 reach a double's rounding."""


def chop_corners(quads: IntArray, members: Sequence[IntArray], nodes: Array,
                 holes: Sequence[Hole]) -> tuple[IntArray, IntArray]:
    """Cut off the corners that stick out into a hole: such a rectangle becomes a triangle.

    A node that belongs to one cell only and lies on a hole, as do both its neighbours in the cell, would become a
    corner of 180 degrees or more once they lie on the outline. ``quads`` are the cells that are left, ``members``, for
    each hole, the nodes of these that its removed cells share. Gives the rectangles that stay, and the triangles.
    """
    n_cells_of_node = np.bincount(quads.ravel(), minlength=len(nodes))
    triangles = [np.zeros((0, 3), np.int64)]
    for member, hole in zip(members, holes, strict=True):
        on_hole = np.zeros(len(nodes), dtype=bool)
        on_hole[member] = True
        touching = on_hole[quads]
        alone = n_cells_of_node[quads] == 1
        tips = touching & alone & np.roll(touching, 1, axis=1) & np.roll(touching, -1, axis=1)
        # A cell with all four nodes on the hole has no side left to keep.
        chosen = np.flatnonzero((tips.sum(axis=1) == 1) & (touching.sum(axis=1) == 3))
        tip = tips[chosen].argmax(axis=1)
        # The corner across from the tip must be outside the hole.
        across = nodes[quads[chosen, (tip + 2) % 4]]
        outside = hole.measure_distance(across) > 0
        chosen, tip = chosen[outside], tip[outside]
        others = (tip[:, None] + np.arange(1, 4)) % 4
        triangles.append(quads[chosen[:, None], others])
        quads = np.delete(quads, chosen, axis=0)
    return quads, np.concatenate(triangles)


def snap_to_holes(mesh: Mesh, members: Sequence[IntArray], holes: Sequence[Hole],
                  region: Sequence[float]) -> tuple[Array, list[IntArray]]:
    """Move the nodes around each hole onto its outline where the cells stay convex and well shaped.

    Nodes on a side of the region (x0, y0, x1, y1) slide along it; its four corners stay. Where a cell would become too
    flat, its moved nodes go back half of their way, and in the end all of it. ``members`` are, for each hole, the nodes
    that its removed cells share with others. Gives all nodes, pixels, and for each hole its own, moved or not.
    """
    if not holes:
        return mesh.nodes, []
    used = np.unique(mesh.connectivity)
    on_holes = _nearest_hole([np.intersect1d(member, used) for member in members], mesh.nodes, holes)
    target = mesh.nodes.copy()
    for member, hole in zip(on_holes, holes, strict=True):
        target[member] = _on_outline(mesh.nodes[member], hole, region)
    for member, hole in zip(on_holes, holes, strict=True):
        if isinstance(hole, OutlinedHole):
            # Nodes on a side of the region stay on it.
            free = member[_is_between_sides(mesh.nodes[member], region)]
            _take_corners(mesh, target, free, hole.corners[_is_between_sides(hole.corners, region)])
    return _move_carefully(mesh, target), on_holes


def _is_between_sides(points: Array, region: Sequence[float]) -> BoolArray:
    return np.asarray(((points > region[:2]) & (points < region[2:])).all(axis=1))


def _take_corners(mesh: Mesh, target: Array, free: IntArray, corners: Array) -> None:
    """Bring a node to each corner of a hole: of those free to go and near it the one whose cells bear it best."""
    for corner in corners:
        near = free[np.argsort(np.linalg.norm(mesh.nodes[free] - corner, axis=1))[:MOST_CANDIDATES]]
        if not len(near):
            return
        qualities = [_measure_worst(mesh, target, int(node), corner) for node in near]
        chosen = near[int(np.argmax(qualities))]
        target[chosen] = corner
        free = free[free != chosen]


def _measure_worst(mesh: Mesh, target: Array, node: int, place: Array) -> float:
    """Smallest sine in the cells around a node, were it to go to a place and the others to their targets."""
    moved = target.copy()
    moved[node] = place
    about = mesh.keep_cells(mesh.find_cells_around(np.arange(mesh.n_nodes) == node))
    return float(measure_shape_quality(replace(about, nodes=moved)).min(initial=np.inf))


def _nearest_hole(members: list[IntArray], nodes: Array, holes: Sequence[Hole]) -> list[IntArray]:
    """Give nodes that several holes touch to the hole whose outline is nearest."""
    away = np.full((len(holes), len(nodes)), np.inf)
    for k, (member, hole) in enumerate(zip(members, holes, strict=True)):
        away[k, member] = np.abs(hole.measure_distance(nodes[member]))
    owner = away.argmin(axis=0)
    return [member[owner[member] == k] for k, member in enumerate(members)]


def _on_outline(points: Array, hole: Hole, region: Sequence[float]) -> Array:
    """Nearest points of the outline; for points on a side of the region, along that side."""
    x0, y0, x1, y1 = region
    moved = hole.find_nearest(points)
    on_vertical = np.isin(points[:, 0], (x0, x1))
    on_horizontal = np.isin(points[:, 1], (y0, y1))
    corner = on_vertical & on_horizontal
    moved[on_vertical] = _along_axis(points[on_vertical], hole, 1)
    moved[on_horizontal] = _along_axis(points[on_horizontal], hole, 0)
    moved[corner] = points[corner]
    return np.clip(moved, [x0, y0], [x1, y1])


def _along_axis(points: Array, hole: Hole, axis: int) -> Array:
    """Slide points along an axis onto the outline, by bisection; those that cannot get there stay."""
    direction = np.zeros(2)
    direction[axis] = 1.0
    here = hole.measure_distance(points)
    reach = (2.0 * np.abs(here))[:, None] * direction
    before, after = points - reach, points + reach
    # The outline lies on the side where the sign of the distance changes.
    lies_after = hole.measure_distance(after) * here < 0
    other = np.where(lies_after[:, None], after, before)
    bracketed = hole.measure_distance(other) * here < 0
    low, high = points.copy(), other
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        same_side = (hole.measure_distance(middle) * here > 0)[:, None]
        low, high = np.where(same_side, middle, low), np.where(same_side, high, middle)
    return np.where(bracketed[:, None], (low + high) / 2, points)


def _move_carefully(mesh: Mesh, target: Array) -> Array:
    """Move nodes towards their targets as far as all cells keep their shape."""
    fraction = np.ones(mesh.n_nodes)
    fraction[(target == mesh.nodes).all(axis=1)] = 0.0
    while True:
        moved = mesh.nodes + fraction[:, None] * (target - mesh.nodes)
        bad = mesh.cells[measure_shape_quality(replace(mesh, nodes=moved)) < SMALLEST_SINE]
        blamed = np.unique(bad[bad >= 0])
        blamed = blamed[fraction[blamed] > 0]
        if len(blamed) == 0:
            return moved
        can_halve = fraction[blamed] > SMALLEST_FRACTION
        fraction[blamed] = np.where(can_halve, fraction[blamed] / 2, 0.0)


MOST_CELLS = 1e9
"""Cells of a mesh: more than any image has pixels, and fewer than overflow a count."""


def build_structured_mesh(region: Sequence[float], element_size: float, cell: Literal["Q4", "T3"] = "Q4",
                    circles: Sequence[tuple[tuple[float, float], float]] = (),
                    polygons: Sequence[Array | OutlinedHole] = (),
                    mask: BoolArray | None = None) -> Mesh:
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
    grid = build_grid_lines(region, element_size)
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
    mesh = build_mesh(grid.nodes, {Q4: quads, T3: triangles})
    nodes, on_holes = snap_to_holes(mesh, members, holes, region)
    sets = grid.sides | {f"hole_{k}": found for k, found in enumerate(on_holes)}
    # Without the nodes that no cell uses any more.
    return replace(mesh, nodes=nodes, node_sets=sets).create_submesh(np.arange(mesh.n_cells))[0]


def _refuse_impossible(region: Sequence[float], element_size: float, cell: str, mask: BoolArray | None) -> None:
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


def build_grid_lines(region: Sequence[float], element_size: float) -> GridLines:
    """Lay the lines of a grid over a region, (x0, y0, x1, y1), pixels; raises InputError as ``count_cells`` does."""
    x0, y0, x1, y1 = region
    n_columns, n_rows = count_cells(region, element_size)
    return GridLines(np.linspace(x0, x1, n_columns + 1), np.linspace(y0, y1, n_rows + 1))


def count_cells(region: Sequence[float], element_size: float) -> tuple[int, int]:
    """Count the columns and rows of cells that cover a region (x0, y0, x1, y1), pixels, before there are any.

    There is one of each at least. Raises InputError where there are more than MOST_CELLS cells in all.
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


def _kept_cells(grid: GridLines, in_holes: Sequence[BoolArray], mask: BoolArray | None) -> BoolArray:
    """Cells in no hole and in the mask."""
    kept: BoolArray = ~np.logical_or.reduce([np.zeros(len(grid.quads), dtype=bool), *in_holes])
    if mask is not None:
        kept &= _cells_in_mask(grid, np.asarray(mask) != 0)
    if not kept.any():
        raise InputError("mesh.structured: no cell is left; holes and mask cover the whole region")
    return kept


def _cells_in_hole(grid: GridLines, hole: Hole, number: int) -> BoolArray:
    """Cells whose centres lie in a hole."""
    inside = hole.measure_distance(grid.centroids) < 0
    # What a mask leaves out may be smaller than a cell; a hole that was asked for may not.
    if not inside.any() and not isinstance(hole, OutlinedHole):
        raise InputError(f"mesh.structured: hole_{number} holds the centre of no cell: it lies outside the "
                         "region, or is too small for element_size; leave it out or use smaller elements")
    return np.asarray(inside)


def _cells_in_mask(grid: GridLines, mask: BoolArray) -> BoolArray:
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


def _split_quads(quads: IntArray, wide: int) -> IntArray:
    """Split rectangles into triangles; the diagonals alternate like the fields of a chessboard."""
    row, column = np.divmod(quads[:, 0], wide)
    even = (row + column) % 2 == 0
    turned = np.where(even[:, None], quads, np.roll(quads, -1, axis=1))
    halves = turned[:, [0, 1, 2, 0, 2, 3]]
    return halves.reshape(-1, 3)
