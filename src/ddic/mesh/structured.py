"""Regular meshes of a region, with holes and masks, along whose outlines the staircase of cells is rounded."""

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np

from ddic.arrays import Array, BoolArray, IntArray
from ddic.errors import InputError
from ddic.images.binned import ArraySource
from ddic.images.source import ImageSource
from ddic.mesh.cell_type import HEX8, Q4, T3
from ddic.mesh.grid import GridLines
from ddic.mesh.holes import (
    Outline,
    OutlinedHole,
    RegionLike,
    build_outside,
    convert_holes,
    convert_region,
    require_inside,
)
from ddic.mesh.mesh import Mesh, build_mesh
from ddic.mesh.quality import measure_shape_quality
from ddic.mesh.topology import find_boundary_facets, find_boundary_sets

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
                 holes: Sequence[Outline]) -> tuple[IntArray, IntArray]:
    """Cut off the corners that stick out into a hole: such a rectangle becomes a triangle.

    A node that belongs to one cell only and lies on a hole, as do both its neighbours in the cell, would become a
    corner of 180 degrees or more once they lie on the outline, unless it is nearest to a corner of that. ``quads`` are
    the cells that are left, ``members``, for each hole, the nodes of these that its removed cells share. Gives the
    rectangles that stay, and the triangles.
    """
    n_cells_of_node = np.bincount(quads.ravel(), minlength=len(nodes))
    triangles = [np.zeros((0, 3), np.int64)]
    for member, hole in zip(members, holes, strict=True):
        on_hole = np.zeros(len(nodes), dtype=bool)
        on_hole[member] = True
        touching = on_hole[quads]
        alone = (n_cells_of_node[quads] == 1) & ~np.isin(quads, _find_nearest_nodes(hole, member, nodes))
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


def _find_nearest_nodes(hole: Outline, member: IntArray, nodes: Array) -> IntArray:
    """The nearest of some nodes to each corner of a hole in the box of all nodes."""
    if not isinstance(hole, OutlinedHole) or not len(member):
        return np.zeros(0, np.int64)
    corners = hole.corners[_is_between_sides(hole.corners, [*nodes.min(axis=0), *nodes.max(axis=0)])]
    nearest = np.linalg.norm(nodes[member, None] - corners, axis=2).argmin(axis=0)
    return np.asarray(member[nearest])


def find_targets(mesh: Mesh, members: Sequence[IntArray], holes: Sequence[Outline], box: Sequence[float]) -> Array:
    """Find where the nodes around holes are to go: the nearest places on the outlines; those of all nodes, pixels.

    Nodes on a side of the box (x0, y0, x1, y1) slide along it; its four corners stay. ``members`` are, for each hole,
    the nodes that its removed cells share with others.
    """
    used = np.unique(mesh.connectivity)
    on_holes = _nearest_hole([np.intersect1d(member, used) for member in members], mesh.nodes, holes)
    target = mesh.nodes.copy()
    for member, hole in zip(on_holes, holes, strict=True):
        target[member] = _on_outline(mesh.nodes[member], hole, box)
    for member, hole in zip(on_holes, holes, strict=True):
        if isinstance(hole, OutlinedHole):
            # Nodes on a side of the box stay on it.
            free = member[_is_between_sides(mesh.nodes[member], box)]
            _take_corners(mesh, target, free, hole.corners[_is_between_sides(hole.corners, box)])
    return target


def _is_between_sides(points: Array, box: Sequence[float]) -> BoolArray:
    return np.asarray(((points > box[:2]) & (points < box[2:])).all(axis=1))


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


def _nearest_hole(members: list[IntArray], nodes: Array, holes: Sequence[Outline]) -> list[IntArray]:
    """Give nodes that several holes touch to the hole whose outline is nearest."""
    away = np.full((len(holes), len(nodes)), np.inf)
    for k, (member, hole) in enumerate(zip(members, holes, strict=True)):
        away[k, member] = np.abs(hole.measure_distance(nodes[member]))
    owner = away.argmin(axis=0)
    return [member[owner[member] == k] for k, member in enumerate(members)]


def _on_outline(points: Array, hole: Outline, box: Sequence[float]) -> Array:
    """Nearest points of the outline; for points on a side of the box, along that side."""
    x0, y0, x1, y1 = box
    moved = hole.find_nearest(points)
    on_vertical = np.isin(points[:, 0], (x0, x1))
    on_horizontal = np.isin(points[:, 1], (y0, y1))
    corner = on_vertical & on_horizontal
    moved[on_vertical] = _along_axis(points[on_vertical], hole, 1)
    moved[on_horizontal] = _along_axis(points[on_horizontal], hole, 0)
    moved[corner] = points[corner]
    return np.clip(moved, [x0, y0], [x1, y1])


def _along_axis(points: Array, hole: Outline, axis: int) -> Array:
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
    """Move nodes towards their targets where the cells stay convex and well shaped; gives all nodes, pixels.

    Where a cell would become too flat, its moved nodes go back half of their way, and in the end all of it.
    """
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


NAME = "mesh.structured"
"""What messages call the mesh."""

MOST_CELLS = 1e9
"""Cells of a mesh: more than any image has pixels, and fewer than overflow a count."""

SMALLEST_PIECE = 0.05
"""Share of a region's cells above which a piece of several that no side joins to the rest is refused; smaller ones, at
tips, are left out. A larger value may lose what was to be measured."""


def build_structured_mesh(region: RegionLike, element_size: float, cell: Literal["Q4", "T3"] = "Q4",
                    circles: Sequence[tuple[tuple[float, float], float]] = (),
                    polygons: Sequence[Array | OutlinedHole] = (),
                    mask: BoolArray | ImageSource | None = None) -> Mesh:
    """Mesh a region by regular cells, in a volume a box by Hex8.

    A cell is removed if its centre lies in a hole, then the nodes around the hole are moved onto its outline; where the
    hole meets a cell at a corner, that corner is cut off, so that a Q4 mesh with holes holds some T3. All around a
    circle or a polygon is a hole too.

    Parameters
    ----------
    region : (x0, y0, x1, y1), (centre, radius) or (n, 2) array
        A box, which cells cover exactly, in a volume (x0, y0, z0, x1, y1, z1); a circle, or the vertices of a polygon;
        pixels.
    element_size : float
        Pixels; there are round(side / element_size) cells along a side of the region's box, at least one, so that cells
        are stretched slightly where the size does not divide the side.
    cell : {"Q4", "T3"}
        T3 with alternating diagonals.
    circles : sequence of (centre, radius)
        Round holes, pixels.
    polygons : sequence of (n, 2) arrays or OutlinedHole
        Vertices of other holes, pixels; what ``find_mask_holes`` finds in a mask.
    mask : array of an image's shape or ImageSource, optional
        Not 0 where cells may be; a cell is kept if at least half of its pixels are.

    Returns
    -------
    Mesh
        With node sets left, right, top, bottom, by where the outer boundary faces, and hole_0, hole_1, ... (circles,
        polygons, then what the mask leaves out inside). In a volume they are the nodes on the box's faces, with front
        and back.

    Raises
    ------
    InputError
        Where an argument is impossible, a hole removes no cell or leaves a region that is no box, or no cell is left.
    """
    outline = convert_region(region, f"{NAME}.region")
    box: Any = region if outline is None else outline.box
    refuse_impossible(box, element_size, cell, NAME)
    dim = len(box) // 2
    source = ArraySource(Path("mask"), np.array(mask)) if isinstance(mask, np.ndarray | list | tuple) else mask
    if source is not None and len(source.extent.sizes) != dim:
        expected = "(height, width)" if dim == 2 else "(depth, height, width)"
        raise InputError(f"{NAME}: a mask of shape {source.extent.shape}, {expected} expected")
    if dim == 3:
        if cell != "Q4" or len(circles) or len(polygons):
            raise InputError(f"{NAME}: circles, polygons and T3 are of a plane; a box in a volume is meshed by Hex8")
        return _build_box(box, element_size, source)
    grid, around = build_grid_lines(box, element_size), []
    declared = convert_holes(circles, [hole for hole in polygons if not isinstance(hole, OutlinedHole)], NAME)
    outlined = [hole for hole in polygons if isinstance(hole, OutlinedHole)]
    if outline is not None:
        require_inside(declared, outline, element_size / 4, NAME)
        grid, around = grid.pad(), [build_outside(outline, element_size)]
    in_declared = [_cells_in_hole(grid, hole, k) for k, hole in enumerate(declared)]
    by_outline = [_cells_in_hole(grid, hole, k) for k, hole in enumerate(outlined)]
    outside = [_cells_outside(grid, hole) for hole in around]
    in_holes = [*in_declared, *by_outline, *outside]
    kept = _kept_cells(grid, in_holes, source)
    members = _find_members(grid, in_holes, kept)
    mesh = _cut_cells(grid, kept, [*declared, *outlined, *around], members, cell, splits_flat=bool(around))
    sets = grid.sides
    if not kept.all():
        by_mask = ~np.logical_or.reduce([kept, *in_declared, *outside])
        inner = [*members[:len(declared)], *_list_mask_holes(grid, kept, by_mask)]
        has_its_sides = mask is None and not (outlined or around)
        sets = _name_boundary(mesh, grid, kept, inner) | (sets if has_its_sides else {})
    # Without the nodes that no cell uses any more, and the sets that this leaves empty.
    mesh = replace(mesh, node_sets=sets).create_submesh(np.arange(mesh.n_cells))[0]
    return replace(mesh, node_sets={name: nodes for name, nodes in mesh.node_sets.items() if len(nodes)})


def refuse_impossible(box: Sequence[float], element_size: float, cell: str, name: str) -> None:
    """Refuse, by an InputError, arguments of which no mesh can be made; ``name`` is what it calls the mesh.

    Case files say them with types and ranges of their own.
    """
    given = f"{name}: region = {box}, element_size = {element_size}"
    numbers = np.asarray([*box, element_size])
    if len(box) not in (4, 6) or numbers.dtype.kind not in "iuf" or not np.isfinite(numbers).all():
        raise InputError(f"{given}: expected (x0, y0, x1, y1) and a size, finite numbers of pixels; "
                         "in a volume (x0, y0, z0, x1, y1, z1)")
    if not ((np.diff(np.reshape(box, (2, -1)), axis=0) > 0).all() and element_size > 0):
        raise InputError(f"{given}: expected x0 < x1, y0 < y1, in a volume z0 < z1, and a size above 0")
    if cell not in ("Q4", "T3"):
        raise InputError(f'{name}: cell = "{cell}": expected "Q4" or "T3"')


def build_grid_lines(region: Sequence[float], element_size: float) -> GridLines:
    """Lay the lines of a grid over a region, pixels; raises InputError as ``count_cells`` does."""
    low, high = np.reshape(np.asarray(region, dtype=np.float64), (2, -1))
    n_along = count_cells(region, element_size)
    return GridLines(tuple(np.linspace(first, last, n + 1) for first, last, n in zip(low, high, n_along, strict=True)))


def count_cells(region: Sequence[float], element_size: float, name: str = NAME) -> tuple[int, ...]:
    """Count the cells along each axis that cover a region, (x0, y0, x1, y1) or its like in a volume, pixels.

    There is one at least. Raises InputError where there are more than MOST_CELLS cells in all; ``name`` is what it
    calls the mesh.
    """
    low, high = np.reshape(np.asarray(region, dtype=np.float64), (2, -1))
    with np.errstate(over="ignore"):
        along = (high - low) / element_size
        n_cells = np.maximum(along, 1.0).prod()
    if not n_cells <= MOST_CELLS:
        listed = ", ".join(f"{side:g}" for side in region)
        raise InputError(f"{name}: element_size = {element_size:g} on region = [{listed}] asks for {n_cells:.3g} "
                         f"elements, more than {MOST_CELLS:.0e}; give larger elements, in pixels")
    return tuple(max(1, round(float(sides))) for sides in along)


def _build_box(box: Sequence[float], element_size: float, mask: ImageSource | None) -> Mesh:
    """Mesh a box in a volume."""
    grid = build_grid_lines(box, element_size)
    cells = grid.cells[_kept_cells(grid, [], mask)]
    mesh = replace(build_mesh(grid.nodes, {HEX8: cells}), node_sets=grid.sides)
    mesh = mesh.create_submesh(np.arange(mesh.n_cells))[0]
    return replace(mesh, node_sets={name: nodes for name, nodes in mesh.node_sets.items() if len(nodes)})


def _kept_cells(grid: GridLines, in_holes: Sequence[BoolArray], mask: ImageSource | None) -> BoolArray:
    """Cells in no hole and in the mask."""
    kept: BoolArray = ~np.logical_or.reduce([np.zeros(grid.n_cells, dtype=bool), *in_holes])
    if mask is not None:
        kept &= _cells_in_mask(grid, mask)
    if not kept.any():
        raise InputError("mesh.structured: no cell is left; holes and mask cover the whole region")
    return kept


def _cells_in_hole(grid: GridLines, hole: Outline, number: int) -> BoolArray:
    """Cells whose centres lie in a hole."""
    inside = hole.measure_distance(grid.centroids) < 0
    # What a mask leaves out may be smaller than a cell; a hole that was asked for may not.
    if not inside.any() and not isinstance(hole, OutlinedHole):
        raise InputError(f"mesh.structured: hole_{number} holds the centre of no cell: it lies outside the "
                         "region, or is too small for element_size; leave it out or use smaller elements")
    return np.asarray(inside)


def _cells_in_mask(grid: GridLines, mask: ImageSource) -> BoolArray:
    """Cells with at least half of their pixel centres in the mask; outside of it counts as False."""
    extent = mask.extent
    # Half-open cells, x <= centre < x', give every pixel centre to exactly one cell.
    ends = [np.ceil(line).astype(np.int64) for line in grid.lines]
    inside = [np.clip(of_line, 0, size) for of_line, size in zip(ends, extent.sizes, strict=True)]
    n_across = reduce(np.multiply.outer, [np.diff(of_line) for of_line in ends[-2::-1]])
    kept = np.empty(grid.n_along[::-1], dtype=bool)
    # Rows of cells, in a volume layers of them, one by one: nobody holds all of a volume's mask.
    for k, (first, last) in enumerate(pairwise(inside[-1].tolist())):
        # Sources refuse to read nothing.
        found = mask.read(extent.take_rows(first, last)) if first < last else np.zeros((0, *extent.shape[1:]))
        in_cells = np.count_nonzero(found, axis=0)
        for places in inside[-2::-1]:
            # Axis by axis, each of which comes last in its turn.
            up_to = np.pad(np.cumsum(in_cells, axis=0), [(1, 0), *[(0, 0)] * (in_cells.ndim - 1)])
            in_cells = np.moveaxis(np.diff(up_to[places], axis=0), 0, -1)
        kept[k] = 2 * in_cells >= n_across * (ends[-1][k + 1] - ends[-1][k])
    return kept.ravel()


def _find_members(grid: GridLines, in_holes: Sequence[BoolArray], kept: BoolArray) -> list[IntArray]:
    """For each hole the nodes that its cells share with those that are kept."""
    quads = grid.cells
    return [np.intersect1d(quads[kept], quads[inside]) for inside in in_holes]


def _cut_cells(grid: GridLines, kept: BoolArray, holes: Sequence[Outline], members: Sequence[IntArray], cell: str,
               *, splits_flat: bool) -> Mesh:
    """The mesh of the cells that are kept, with all nodes of the grid, those around holes on the outlines."""
    quads, triangles = chop_corners(grid.cells[kept], members, grid.nodes, holes)
    if not holes:
        return _build_cells(grid, quads, triangles, cell)
    if splits_flat:
        target = find_targets(_build_cells(grid, quads, triangles, "Q4"), members, holes, grid.box)
        mesh = _build_cells(grid, quads, triangles, cell, target)
    else:
        # After the split, so that the cells whose shape is watched are those of the mesh.
        mesh = _build_cells(grid, quads, triangles, cell)
        target = find_targets(mesh, members, holes, grid.box)
    return replace(mesh, nodes=_move_carefully(mesh, target))


def _cells_outside(grid: GridLines, outside: OutlinedHole) -> BoolArray:
    """Cells to remove around a region: those whose centres lie outside, and those that hang on the rest by no side.

    Of cells that reach outside those too that would be flat on the region's outline, as happens in its corners.
    """
    outer = ~_keep_largest_piece(outside.measure_distance(grid.centroids) > 0, grid)
    reaches_out = (outside.measure_distance(grid.nodes) < 0)[grid.cells].any(axis=1)
    while True:
        members = _find_members(grid, [outer], ~outer)
        quads, triangles = chop_corners(grid.cells[~outer], members, grid.nodes, [outside])
        target = find_targets(_build_cells(grid, quads, triangles, "Q4"), members, [outside], grid.box)
        is_flat = _measure_sines(quads, grid.nodes, target)[1:].max(axis=0) < SMALLEST_SINE
        spoilt = reaches_out & ~outer & np.isin(grid.cells[:, 0], quads[is_flat, 0])
        if not spoilt.any():
            return outer
        outer = ~_keep_largest_piece(~(outer | spoilt), grid)


def _keep_largest_piece(inside: BoolArray, grid: GridLines) -> BoolArray:
    """The cells of a region without those that no side joins to most of them; InputError where these are many."""
    by_row = inside.reshape(grid.n_along[1], -1).astype(np.uint8)
    _, labels, sizes, _ = cv2.connectedComponentsWithStats(by_row, connectivity=4)
    n_cells = np.append(sizes[1:, cv2.CC_STAT_AREA], 0)
    if n_cells.max() == 0:
        raise InputError(f"{NAME}.region: holds no element: it is too narrow for element_size; use smaller elements")
    if np.sort(n_cells)[-2] > max(1, SMALLEST_PIECE * inside.sum()):
        raise InputError(f"{NAME}.region: falls into {(n_cells > 0).sum()} pieces where it is narrower than "
                         "element_size; use smaller elements")
    return np.asarray(labels.ravel() == 1 + n_cells.argmax())


def _list_mask_holes(grid: GridLines, kept: BoolArray, by_mask: BoolArray) -> list[IntArray]:
    """Nodes of the cells of each hole that a mask makes inside, from top to bottom.

    ``by_mask`` are the cells that are left out for the mask alone.
    """
    cut_out = np.pad(~kept.reshape(grid.n_along[1], -1), 1, constant_values=True).astype(np.uint8)
    labels = cv2.connectedComponents(cut_out, connectivity=8)[1]
    outer, of_cells = labels[0, 0], labels[1:-1, 1:-1].ravel()
    inside = by_mask & (of_cells != outer)
    quads, of_quads = grid.cells[inside], of_cells[inside]
    return [np.unique(quads[of_quads == number]) for number in dict.fromkeys(of_quads.tolist())]


def _name_boundary(mesh: Mesh, grid: GridLines, kept: BoolArray, of_holes: Sequence[IntArray]) -> dict[str, IntArray]:
    """Name the nodes of the boundary; only the cells about it are looked at."""
    quads = grid.cells
    is_used, is_at_edge = np.zeros((2, grid.n_nodes), dtype=bool)
    is_used[quads[kept]] = True
    is_at_edge[quads[~kept]] = True
    for side in grid.sides.values():
        is_at_edge[side] = True
    about, node_ids = mesh.create_submesh(mesh.find_cells_around(is_used & is_at_edge))
    facets = node_ids[find_boundary_facets(about)]
    # Other facets at the edge of these cells lie inside.
    return find_boundary_sets(mesh.nodes, facets[is_at_edge[facets].all(axis=1)], of_holes)


def _build_cells(grid: GridLines, quads: IntArray, triangles: IntArray, cell: str, target: Array | None = None) -> Mesh:
    """Build the mesh of rectangles and triangles of a grid, rectangles split for T3.

    The diagonals alternate like the fields of a chessboard. With a target of the nodes, the other one is taken where a
    triangle would be too flat there, and a rectangle that would be is split.
    """
    row, column = np.divmod(quads[:, 0], len(grid.lines[0]))
    is_turned = (row + column) % 2 == 1
    is_split = np.full(len(quads), cell == "T3")
    if target is not None:
        whole, *halves = _measure_sines(quads, grid.nodes, target)
        own, other = np.where(is_turned, halves[::-1], halves)
        is_turned ^= (own < SMALLEST_SINE) & (other > own)
        # Triangles tell of short sides too.
        is_split |= np.minimum(whole, np.maximum(own, other)) < SMALLEST_SINE
    split = _halve(quads[is_split], is_turned[is_split])
    return build_mesh(grid.nodes, {Q4: quads[~is_split], T3: np.concatenate([split, triangles])})


def _halve(quads: IntArray, is_turned: BoolArray) -> IntArray:
    """Halve rectangles along the diagonal from their first node, or along the other one where that is turned."""
    from_diagonal = np.where(is_turned[:, None], np.roll(quads, -1, axis=1), quads)
    return from_diagonal[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)


def _measure_sines(quads: IntArray, nodes: Array, target: Array) -> Array:
    """Least sine of the corners of rectangles whose nodes have moved, and of both halves by either diagonal, (3, n)."""
    sines = np.ones((3, len(quads)))
    is_moved = (nodes != target).any(axis=1)[quads].any(axis=1)
    moved = quads[is_moved]
    sines[0, is_moved] = measure_shape_quality(build_mesh(target, {Q4: moved}))
    for k, turned in enumerate((False, True), start=1):
        halves = build_mesh(target, {T3: _halve(moved, np.full(len(moved), turned))})
        sines[k, is_moved] = measure_shape_quality(halves).reshape(-1, 2).min(axis=1)
    return sines
