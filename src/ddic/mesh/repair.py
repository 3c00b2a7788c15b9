"""Repair of a mesh's orientation and numbering; refusal of cells that are degenerate or do not meet side to side."""

from dataclasses import replace

import numpy as np

from ddic.arrays import Array, IntArray
from ddic.errors import InputError, list_first
from ddic.images.window import Window
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import build_tree
from ddic.mesh.quality import measure_areas, measure_shape_quality
from ddic.mesh.raster import find_crossings, rasterize
from ddic.mesh.topology import Facets, find_distinct_rows, find_facets

SMALLEST_SINE = 1e-8
"""Sine of a corner below which a cell is degenerate: far below any mesh generator's, far above rounding. A larger
value refuses more meshes."""

SLACK = 1e-6
"""Distance, pixels, by which a node may lie outside the image: rounding of a mapping. A larger value forgives more."""


def repair(mesh: Mesh) -> Mesh:
    """Orient all cells positively in (x, y) and drop unused nodes; cells keep their order.

    Node sets are renumbered. Raises InputError on coordinates that are not finite, unknown or repeated nodes, duplicate
    cells, and cells that are flat, crossed or not convex, with their numbers.
    """
    _refuse_bad_numbers(mesh)
    oriented = _orient(mesh)
    _refuse_bad_cells(oriented)
    return oriented.create_submesh(np.arange(mesh.n_cells))[0]


def check_inside(mesh: Mesh, extent: Window) -> None:
    """Refuse a mesh with nodes outside the image, of which the whole box is given; raises InputError."""
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    # Pixel centres are at integers, so the first pixel begins at -0.5.
    first, last = -0.5, np.array(extent.upper) - 0.5
    if (low >= first - SLACK).all() and (high <= last + SLACK).all():
        return
    lowest, highest = (", ".join(f"{place:.6g}" for place in corner) for corner in (low, high))
    raise InputError(
        f"the mesh lies outside the image: nodes from ({lowest}) to ({highest}) px, image {extent.describe()} px (from "
        f"-0.5 to {' and '.join(str(end) for end in last)}); correct the region, or mesh.mapping (scale, rotation, "
        "translation)")


def check_pixels(mesh: Mesh, pixel_counts: IntArray, path: str) -> None:
    """Refuse a mesh with cells that hold no pixel centre; raises InputError, whose message names ``path``."""
    empty = np.flatnonzero(np.asarray(pixel_counts) == 0)
    if len(empty):
        raise InputError(f"{path}: {_cells(empty)} of {mesh.n_cells} hold no pixel: use larger elements, "
                         "or correct the scale from mesh units to pixels")


def _refuse_bad_numbers(mesh: Mesh) -> None:
    """Refuse nodes that do not exist or lie nowhere."""
    if mesh.n_cells == 0:
        raise InputError("the mesh has no cell")
    cells = mesh.cells
    padding = np.arange(cells.shape[1]) >= np.diff(mesh.offsets)[:, None]
    negative = (cells < 0) & ~padding
    unknown = (negative | (cells >= mesh.n_nodes)).any(axis=1)
    if unknown.any():
        raise InputError(f"{_cells(np.flatnonzero(unknown))} name nodes that do not exist "
                         f"(there are {mesh.n_nodes}): export the mesh again")
    is_lost = ~np.isfinite(mesh.nodes).all(axis=1)
    # Nodes that no cell uses may be anything.
    lost = np.unique(mesh.connectivity[is_lost[mesh.connectivity]])
    if len(lost):
        raise InputError(f"nodes {list_first(lost)} have coordinates that are not finite numbers")


def _orient(mesh: Mesh) -> Mesh:
    """Turn the cells of negative area, or volume, inside out."""
    negative = measure_areas(mesh) < 0
    if not negative.any():
        return mesh
    cells = mesh.cells.copy()
    for block in mesh.cell_blocks:
        chosen = block.cells[negative[block.cells]]
        cells[chosen, :block.type.n_nodes] = cells[chosen][:, block.type.mirrored]
    return replace(mesh, connectivity=cells[cells >= 0])


def _refuse_bad_cells(mesh: Mesh) -> None:
    """Refuse cells without a shape, with a line for each kind of fault."""
    ordered = np.sort(mesh.cells, axis=1)
    same_as_next = (ordered[:, 1:] == ordered[:, :-1]) & (ordered[:, 1:] >= 0)
    repeated = same_as_next.any(axis=1)
    duplicate = np.ones(mesh.n_cells, dtype=bool)
    duplicate[find_distinct_rows(ordered, mesh.n_nodes)[0]] = False
    bad_shape = ~repeated & (measure_shape_quality(mesh) < SMALLEST_SINE)
    remedies = (
        (repeated, "have a node twice: split or delete them in the mesh generator"),
        (duplicate, "repeat an earlier cell: delete them, or export the mesh again without copies"),
        (bad_shape, "are flat, crossed or not convex: correct them in the mesh generator"),
    )
    problems = [f"{_cells(np.flatnonzero(bad))} {remedy}" for bad, remedy in remedies if bad.any()]
    if problems:
        raise InputError(problems)


def _cells(numbers: IntArray) -> str:
    """How many cells, and the first of them."""
    return f"{len(numbers)} cells (numbered from 0: {list_first(numbers)})"


SHARED = 0.05
"""Share of a cell's pixels that other cells hold too, above which cells overlap: less is rounding in a mesh generator,
along sides that touch. A larger value forgives more."""

ON_SIDE = 1e-3
"""Distance from a side, over its length, below which a node lies on it. A larger value refuses more."""


def check_joints(mesh: Mesh) -> None:
    """Refuse a mesh whose cells do not meet side to side, each place once: displacements would tear or count twice.

    Raises InputError with a line for each kind of fault: more than two cells at a side, nodes on a side that is not
    theirs, cells that overlap. Cells along a slit, with nodes of their own on either side of it, are none of these. The
    mesh must lie inside the image, all cells positively oriented.
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


def _find_hanging_nodes(mesh: Mesh, facets: Facets) -> IntArray:
    """Nodes at the mesh's edge on a side there that is not theirs."""
    facets_there = facets.nodes[facets.n_cells == 1]
    # Sides in the plane; in space triangles, of which a face of four nodes has two.
    sides = np.concatenate([facets_there[:, [0, *range(k, k + mesh.dim - 1)]]
                            for k in range(1, facets_there.shape[1] - mesh.dim + 2)])
    sides = sides[(sides >= 0).all(axis=1)]
    nodes, corners = np.unique(sides), mesh.nodes[sides]
    middles = corners.mean(axis=1)
    radii = np.linalg.norm(corners - middles[:, None], axis=2).max(axis=1)
    near = build_tree(mesh.nodes[nodes]).query_ball_point(middles, radii)
    numbers = np.repeat(np.arange(len(sides)), [len(found) for found in near])
    found = nodes[np.concatenate(near).astype(np.int64)]
    points, edges = mesh.nodes[found] - corners[numbers, 0], (corners[:, 1:] - corners[:, :1])[numbers]
    # Shares of the corners in the place on the side that is nearest, and how far off that is, over the side's length.
    along = np.linalg.solve(edges @ edges.transpose(0, 2, 1), (edges @ points[:, :, None]))[:, :, 0]
    shares = np.column_stack([1.0 - along.sum(axis=1), along])
    off = np.linalg.norm(points - np.einsum("nk,nkj->nj", along, edges), axis=1)
    lengths = np.linalg.norm(edges, axis=2).max(axis=1)
    is_inside = (shares > -ON_SIDE).all(axis=1) & (shares < 1 - ON_SIDE).all(axis=1) & (off < ON_SIDE * lengths)
    return np.asarray(np.unique(found[is_inside]))


def _find_overlapping_cells(mesh: Mesh, facets: Facets) -> IntArray:
    """Cells of which others hold more than SHARED of the pixels."""
    if mesh.dim == 2 and not _is_covered_twice(mesh, facets):
        return np.zeros(0, np.int64)
    raster = rasterize(mesh)
    if not raster.pixel_counts.any():
        return np.zeros(0, np.int64)
    return np.flatnonzero(raster.find_shared(raster.window) > SHARED * np.maximum(raster.pixel_counts, 1))


def _is_covered_twice(mesh: Mesh, facets: Facets) -> bool:
    """Whether a pixel of an image belongs to two cells: told by the mesh's edge alone, without all pixels.

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


def _list_places(points: Array) -> str:
    """The first places."""
    listed = ", ".join(f"({', '.join(f'{place:.6g}' for place in point)})" for point in points[:3])
    return listed + (", ..." if len(points) > 3 else "")
