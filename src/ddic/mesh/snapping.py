"""Rounding of the staircase that cells removed from a grid leave around a hole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.cell_type import Q4, T3
from ddic.mesh.holes import Hole
from ddic.mesh.mesh import build_mesh
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

Cells = NDArray[np.int64]


def chop_corners(quads: Cells, members: Sequence[Cells], nodes: NDArray[np.float64],
                 holes: Sequence[Hole]) -> tuple[Cells, Cells]:
    """Cut off the corners that stick out into a hole: such a rectangle becomes a triangle.

    A node that belongs to one cell only and lies on a hole, as do both its neighbours in the cell, would become a
    corner of 180 degrees or more once they lie on the outline.

    Parameters
    ----------
    quads : (n, 4) int64 array
        Cells that are left.
    members : sequence of int64 arrays
        For each hole, the nodes of these that its removed cells share.
    nodes : (n_nodes, 2) array
        Pixels.
    holes : sequence of Hole
        The holes.

    Returns
    -------
    quads : (n, 4) int64 array
        Those that stay.
    triangles : (n, 3) int64 array
        What is left of the others.
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


def snap_to_holes(nodes: NDArray[np.float64], quads: Cells, triangles: Cells, members: Sequence[Cells],
                  holes: Sequence[Hole], region: Sequence[float],
                  ) -> tuple[NDArray[np.float64], list[Cells]]:
    """Move the nodes around each hole onto its outline where the cells stay convex and well shaped.

    Nodes on a side of the region slide along it; its four corners stay. Where a cell would become too flat, its moved
    nodes go back half of their way, and in the end all of it.

    Parameters
    ----------
    nodes : (n_nodes, 2) array
        Pixels.
    quads : (n, 4) int64 array
        Cells of four nodes.
    triangles : (n, 3) int64 array
        Cells of three nodes.
    members : sequence of int64 arrays
        For each hole, the nodes that its removed cells share with others.
    holes : sequence of Hole
        The holes.
    region : (x0, y0, x1, y1)
        Pixels.

    Returns
    -------
    nodes : (n_nodes, 2) array
        Where they are now, pixels.
    on_holes : list of int64 arrays
        For each hole its nodes, moved or not.
    """
    if not holes:
        return nodes, []
    used = np.unique(np.concatenate([quads.ravel(), triangles.ravel()]))
    on_holes = _nearest_hole([np.intersect1d(member, used) for member in members], nodes, holes)
    target = nodes.copy()
    for member, hole in zip(on_holes, holes, strict=True):
        target[member] = _on_outline(nodes[member], hole, region)
    for member, hole in zip(on_holes, holes, strict=True):
        _take_corners(_Snapping(nodes, target, (quads, triangles), region), member, hole)
    return _move_carefully(nodes, target, quads, triangles), on_holes


@dataclass(frozen=True, eq=False)
class _Snapping:
    """Nodes where they were and where they go, (n_nodes, 2) each, their cells, and the region (x0, y0, x1, y1)."""

    nodes: NDArray[np.float64]
    target: NDArray[np.float64]
    cells: tuple[Cells, Cells]
    region: Sequence[float]


def _take_corners(snapping: _Snapping, member: Cells, hole: Hole) -> None:
    """Bring a node to each corner of a hole: of those near it the one whose cells bear it best."""
    nodes, target = snapping.nodes, snapping.target
    x0, y0, x1, y1 = snapping.region

    def is_inside(points: NDArray[np.float64]) -> NDArray[np.bool_]:
        return np.asarray(((points > [x0, y0]) & (points < [x1, y1])).all(axis=1))

    # Nodes on a side of the region stay on it.
    free = member[is_inside(nodes[member])]
    for corner in hole.corners[is_inside(hole.corners)]:
        near = free[np.argsort(np.linalg.norm(nodes[free] - corner, axis=1))[:MOST_CANDIDATES]]
        if not len(near):
            return
        qualities = [_measure_worst(snapping, int(node), corner) for node in near]
        chosen = near[int(np.argmax(qualities))]
        target[chosen] = corner
        free = free[free != chosen]


def _measure_worst(snapping: _Snapping, node: int, place: NDArray[np.float64]) -> float:
    """Smallest sine in the cells around a node, were it to go to a place."""
    moved = snapping.target.copy()
    moved[node] = place
    quads, triangles = (cells[(cells == node).any(axis=1)] for cells in snapping.cells)
    return float(measure_shape_quality(build_mesh(moved, {Q4: quads, T3: triangles})).min(initial=np.inf))


def _nearest_hole(members: list[Cells], nodes: NDArray[np.float64], holes: Sequence[Hole]) -> list[Cells]:
    """Give nodes that several holes touch to the hole whose outline is nearest."""
    if not holes:
        return []
    away = np.full((len(holes), len(nodes)), np.inf)
    for k, (member, hole) in enumerate(zip(members, holes, strict=True)):
        away[k, member] = np.abs(hole.measure_distance(nodes[member]))
    owner = away.argmin(axis=0)
    return [member[owner[member] == k] for k, member in enumerate(members)]


def _on_outline(points: NDArray[np.float64], hole: Hole, region: Sequence[float]) -> NDArray[np.float64]:
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


def _along_axis(points: NDArray[np.float64], hole: Hole, axis: int) -> NDArray[np.float64]:
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


def _move_carefully(nodes: NDArray[np.float64], target: NDArray[np.float64], quads: Cells,
                    triangles: Cells) -> NDArray[np.float64]:
    """Move nodes towards their targets as far as all cells keep their shape."""
    fraction = np.ones(len(nodes))
    fraction[(target == nodes).all(axis=1)] = 0.0
    while True:
        moved = nodes + fraction[:, None] * (target - nodes)
        mesh = build_mesh(moved, {Q4: quads, T3: triangles})
        bad = mesh.cells[measure_shape_quality(mesh) < SMALLEST_SINE]
        blamed = np.unique(bad[bad >= 0])
        blamed = blamed[fraction[blamed] > 0]
        if len(blamed) == 0:
            return moved
        can_halve = fraction[blamed] > SMALLEST_FRACTION
        fraction[blamed] = np.where(can_halve, fraction[blamed] / 2, 0.0)
