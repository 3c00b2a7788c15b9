"""How cells meet: side to side and each place once, or a displacement would tear there or be counted twice."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError, list_first
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import build_tree
from ddic.mesh.raster import Raster, find_crossings, rasterize
from ddic.mesh.topology import Facets, find_facets

SHARED = 0.05
"""Share of a cell's pixels that other cells hold too, above which cells overlap: less is rounding in a mesh generator,
along sides that touch. A larger value forgives more."""

ON_SIDE = 1e-3
"""Distance from a side, over its length, below which a node lies on it. A larger value refuses more."""


def check_joints(mesh: Mesh) -> None:
    """Refuse a mesh whose cells do not meet as those of a finite element mesh do.

    Cells along a slit, with nodes of their own on either side of it, are none of these.

    Parameters
    ----------
    mesh : Mesh
        Inside the image, all cells positively oriented.

    Raises
    ------
    InputError
        With a line for each kind of fault: more than two cells at a side, nodes on a side that is not theirs, cells
        that overlap.
    """
    facets = find_facets(mesh)
    crowded = np.flatnonzero(facets.n_cells > 2)
    too_many = np.unique(facets.side_cells[np.isin(facets.side_facets, crowded)])
    hanging = _find_hanging_nodes(mesh, facets)
    # Three cells at a side overlap, which is said once.
    overlapping = np.setdiff1d(_find_overlapping_cells(mesh, facets), too_many)
    problems = []
    if len(crowded):
        problems.append(f"{len(crowded)} sides belong to more than two cells (among cells, numbered from 0: "
                        f"{list_first(too_many)}): delete the cells that are too many")
    if len(hanging):
        problems.append(f"{len(hanging)} nodes lie on a side of a cell that they are no corner of (at "
                        f"{_list_places(mesh.nodes[hanging])} px): the displacement would tear there; join the parts "
                        "of the mesh node to node in the mesh generator")
    if len(overlapping):
        problems.append(f"{len(overlapping)} cells (numbered from 0: {list_first(overlapping)}) lie over others: "
                        "delete those that are too many")
    if problems:
        raise InputError(problems)


def _find_hanging_nodes(mesh: Mesh, facets: Facets) -> NDArray[np.int64]:
    """Nodes at the mesh's edge inside a side there that is not theirs."""
    sides = facets.nodes[facets.n_cells == 1][:, :2]
    nodes = np.unique(sides)
    first, second = mesh.nodes[sides[:, 0]], mesh.nodes[sides[:, 1]]
    lengths = np.linalg.norm(second - first, axis=1)
    near = build_tree(mesh.nodes[nodes]).query_ball_point((first + second) / 2, lengths / 2)
    numbers = np.repeat(np.arange(len(sides)), [len(found) for found in near])
    found = nodes[np.concatenate(near).astype(np.int64)]
    along, off = _measure_place(mesh.nodes[found] - first[numbers], (second - first)[numbers])
    is_inside = (along > ON_SIDE) & (along < 1 - ON_SIDE) & (np.abs(off) < ON_SIDE)
    return np.asarray(np.unique(found[is_inside]))


def _measure_place(points: NDArray[np.float64],
                   sides: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Places of points along sides and off them, over the sides' lengths."""
    squares = (sides**2).sum(axis=1)
    along = (points * sides).sum(axis=1) / squares
    off = (points[:, 0] * sides[:, 1] - points[:, 1] * sides[:, 0]) / squares
    return along, off


def _find_overlapping_cells(mesh: Mesh, facets: Facets) -> NDArray[np.int64]:
    """Cells of which others hold more than SHARED of the pixels."""
    if not _is_covered_twice(mesh, facets):
        return np.zeros(0, np.int64)
    raster = rasterize(mesh)
    counts, window = raster.pixel_counts, raster.window
    times = _count_cells_of_pixels(raster)
    shared = raster.sum_by_cell((times > 1).astype(np.float64), window.x0, window.y0)
    return np.flatnonzero(shared > SHARED * np.maximum(counts, 1))


def _is_covered_twice(mesh: Mesh, facets: Facets) -> bool:
    """Whether a pixel belongs to two cells: told by the mesh's edge alone, without all pixels.

    As many cells hold a pixel as sides that a row enters them by lie before it, less those that it leaves them by; of
    the two sides where cells meet, one is of either kind.
    """
    ways = np.where(facets.run_backwards, -1, 1)
    surplus = np.bincount(facets.side_facets, ways, len(facets.nodes)).astype(np.int64)
    at_edge = np.repeat(np.arange(len(surplus)), np.abs(surplus))
    ends = mesh.nodes[facets.nodes[at_edge, :2]]
    # Cells run positively: sides along +y are the last of them in a row.
    is_last = (ends[:, 1, 1] > ends[:, 0, 1]) == (surplus[at_edge] > 0)
    sides, rows, columns = find_crossings(ends)
    # Where one cell ends and another begins, no pixel is in both.
    order = np.lexsort((~is_last[sides], columns, rows))
    n_cells = np.cumsum(np.where(is_last[sides[order]], -1, 1))
    return bool((n_cells > 1).any())


def _count_cells_of_pixels(raster: Raster) -> NDArray[np.int32]:
    """Number of cells that each pixel of the raster's window belongs to, (height, width)."""
    window = raster.window
    changes = np.zeros((window.height, window.width + 1), dtype=np.int32)
    filled = raster.stops > raster.starts
    rows = raster.rows[filled] - window.y0
    np.add.at(changes, (rows, raster.starts[filled] - window.x0), 1)
    np.add.at(changes, (rows, raster.stops[filled] - window.x0), -1)
    return np.asarray(np.cumsum(changes, axis=1, dtype=np.int32)[:, :-1])


def _list_places(points: NDArray[np.float64]) -> str:
    """The first places."""
    listed = ", ".join(f"({x:.6g}, {y:.6g})" for x, y in points[:3])
    return listed + (", ..." if len(points) > 3 else "")
