"""Rounding of the staircase that cells removed from a grid leave around a hole."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.cell_type import Q4, T3
from ddic.mesh.holes import Hole
from ddic.mesh.mesh import mesh_from_cells
from ddic.mesh.quality import shape_quality

SMALLEST_SINE = 0.2
"""Sine of the sharpest or flattest corner (12 or 168 degrees) that moving a node may cause."""

Cells = NDArray[np.int64]


def chop_corners(quads: Cells, members: Sequence[Cells], nodes: NDArray[np.float64],
                 holes: Sequence[Hole]) -> tuple[Cells, Cells]:
    """Cut off the corners that stick out into a hole: such a rectangle becomes a triangle.

    quads: (n, 4) cells left. members[k]: nodes of these that removed cells of hole k share.
    Returns (quads, triangles (n, 3)). A node that belongs to one cell only and lies on a hole, as do both
    its neighbours in the cell, would become a corner of 180 degrees or more once they lie on the outline.
    """
    uses = np.bincount(quads.ravel(), minlength=len(nodes))
    triangles = []
    for member, hole in zip(members, holes, strict=True):
        on_hole = np.zeros(len(nodes), dtype=bool)
        on_hole[member] = True
        touching = on_hole[quads]
        tips = (touching & (uses[quads] == 1) & np.roll(touching, 1, axis=1) & np.roll(touching, -1, axis=1))
        # A cell with all four nodes on the hole has no side left to keep.
        chosen = np.flatnonzero((tips.sum(axis=1) == 1) & (touching.sum(axis=1) == 3))
        tip = tips[chosen].argmax(axis=1)
        inner = nodes[quads[chosen, (tip + 2) % 4]]
        chosen, tip = chosen[hole.distance(inner) > 0], tip[hole.distance(inner) > 0]
        around = (tip[:, None] + np.arange(1, 4)) % 4
        triangles.append(quads[chosen[:, None], around])
        quads = np.delete(quads, chosen, axis=0)
    return quads, np.concatenate([np.zeros((0, 3), np.int64), *triangles])


def snap_to_holes(nodes: NDArray[np.float64], quads: Cells, triangles: Cells, members: Sequence[Cells],
                  holes: Sequence[Hole], region: Sequence[float],
                  ) -> tuple[NDArray[np.float64], list[Cells]]:
    """Move the nodes around each hole onto its outline where the cells stay convex and well shaped.

    Returns the moved nodes (n, 2), pixels, and for each hole its nodes, moved or not. Nodes on a side of
    the region slide along it; its four corners stay. Where a cell would become too flat, its moved nodes
    go back half of their way, and in the end all of it.
    """
    used = np.unique(np.concatenate([quads.ravel(), triangles.ravel()]))
    owned = _nearest_hole([np.intersect1d(member, used) for member in members], nodes, holes)
    target = nodes.copy()
    for member, hole in zip(owned, holes, strict=True):
        target[member] = _on_outline(nodes[member], hole, region)
    return _careful_move(nodes, target, quads, triangles), owned


def _nearest_hole(members: list[Cells], nodes: NDArray[np.float64], holes: Sequence[Hole]) -> list[Cells]:
    """Give nodes that several holes touch to the hole whose outline is nearest."""
    if not holes:
        return []
    away = np.full((len(holes), len(nodes)), np.inf)
    for k, (member, hole) in enumerate(zip(members, holes, strict=True)):
        away[k, member] = np.abs(hole.distance(nodes[member]))
    owner = away.argmin(axis=0)
    return [member[owner[member] == k] for k, member in enumerate(members)]


def _on_outline(points: NDArray[np.float64], hole: Hole, region: Sequence[float]) -> NDArray[np.float64]:
    """Nearest points of the outline; for points on a side of the region, along that side."""
    x0, y0, x1, y1 = region
    moved = hole.nearest(points)
    on_vertical = np.isin(points[:, 0], (x0, x1))
    on_horizontal = np.isin(points[:, 1], (y0, y1))
    for fixed, axis in ((on_vertical, 0), (on_horizontal, 1)):
        moved[fixed] = _along_axis(points[fixed], hole, 1 - axis)
    moved[on_vertical & on_horizontal] = points[on_vertical & on_horizontal]
    return np.clip(moved, [x0, y0], [x1, y1])


def _along_axis(points: NDArray[np.float64], hole: Hole, axis: int) -> NDArray[np.float64]:
    """Slide points along an axis onto the outline, by bisection; those that cannot get there stay."""
    step = np.zeros(2)
    step[axis] = 1.0
    reach = 2.0 * np.abs(hole.distance(points))
    before, after = points - reach[:, None] * step, points + reach[:, None] * step
    here = hole.distance(points)
    # The outline lies on the side where the sign of the distance changes.
    other = np.where((hole.distance(after) * here < 0)[:, None], after, before)
    bracketed = hole.distance(other) * here < 0
    low, high = points.copy(), other
    for _ in range(50):
        middle = (low + high) / 2
        same = (hole.distance(middle) * here > 0)[:, None]
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return np.where(bracketed[:, None], (low + high) / 2, points)


def _careful_move(nodes: NDArray[np.float64], target: NDArray[np.float64], quads: Cells, triangles: Cells,
                  ) -> NDArray[np.float64]:
    """Move nodes towards their targets as far as all cells keep their shape."""
    mesh = mesh_from_cells(nodes, {Q4: quads, T3: triangles})
    fraction = np.ones(len(nodes))
    fraction[(target == nodes).all(axis=1)] = 0.0
    while True:
        moved = nodes + fraction[:, None] * (target - nodes)
        cells = mesh_from_cells(moved, {Q4: quads, T3: triangles})
        bad = mesh.cells[shape_quality(cells) < SMALLEST_SINE]
        blamed = np.unique(bad[bad >= 0])
        blamed = blamed[fraction[blamed] > 0]
        if len(blamed) == 0:
            return moved
        fraction[blamed] = np.where(fraction[blamed] > 0.25, fraction[blamed] / 2, 0.0)
