"""Repair of a mesh's orientation and numbering; refusal of cells that nothing can be computed on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError, list_first
from ddic.mesh.mesh import Mesh
from ddic.mesh.quality import measure_areas, measure_shape_quality

SMALLEST_SINE = 1e-8
"""Sine of a corner below which a cell is degenerate: far below any mesh generator's, far above rounding. A larger
value refuses more meshes."""

SLACK = 1e-6
"""Distance, pixels, by which a node may lie outside the image: rounding of a mapping. A larger value forgives more."""


def repair(mesh: Mesh) -> Mesh:
    """Orient all cells positively in (x, y) and drop unused nodes; cells keep their order.

    Parameters
    ----------
    mesh : Mesh
        As read from a file.

    Returns
    -------
    Mesh
        With node sets renumbered.

    Raises
    ------
    InputError
        On coordinates that are not finite, unknown or repeated nodes, duplicate cells, and cells that are flat, crossed
        or not convex, with their numbers.
    """
    _refuse_bad_numbers(mesh)
    oriented = _orient(mesh)
    _refuse_bad_cells(oriented)
    return oriented.create_submesh(np.arange(mesh.n_cells))[0]


def check_inside(mesh: Mesh, width: int, height: int) -> None:
    """Refuse a mesh with nodes outside the image.

    Parameters
    ----------
    mesh : Mesh
        Any.
    width, height : int
        Size of the image, pixels.

    Raises
    ------
    InputError
        Where a node lies outside.
    """
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    # Pixel centres are at integers, so the first pixel begins at -0.5.
    first, last = -0.5, np.array([width, height]) - 0.5
    if (low >= first - SLACK).all() and (high <= last + SLACK).all():
        return
    raise InputError(
        f"the mesh lies outside the image: nodes from ({low[0]:.6g}, {low[1]:.6g}) to "
        f"({high[0]:.6g}, {high[1]:.6g}) px, image {width}x{height} px (from -0.5 to {width - 0.5} and "
        f"{height - 0.5}); correct the region, or mesh.mapping (scale, rotation, translation)")


def check_pixels(mesh: Mesh, pixel_counts: NDArray[np.int64], path: str) -> None:
    """Refuse a mesh with cells that hold no pixel centre.

    Parameters
    ----------
    mesh : Mesh
        Any.
    pixel_counts : (n_cells,) int64 array
        Pixels of each cell.
    path : str
        Where the mesh comes from, for the message.

    Raises
    ------
    InputError
        Where a cell has none.
    """
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
    """Reverse the cells of negative area; the first node stays first."""
    negative = measure_areas(mesh) < 0
    if not negative.any():
        return mesh
    cells = mesh.cells.copy()
    for block in mesh.cell_blocks:
        n = block.type.n_nodes
        chosen = block.cells[negative[block.cells]]
        cells[chosen, 1:n] = cells[chosen, 1:n][:, ::-1]
    return Mesh(mesh.nodes, cells[cells >= 0], mesh.offsets, mesh.types, mesh.node_sets, mesh.mapping)


def _refuse_bad_cells(mesh: Mesh) -> None:
    """Refuse cells without a shape, with a line for each kind of fault."""
    ordered = np.sort(mesh.cells, axis=1)
    same_as_next = (ordered[:, 1:] == ordered[:, :-1]) & (ordered[:, 1:] >= 0)
    repeated = same_as_next.any(axis=1)
    duplicate = _duplicates(ordered)
    bad_shape = ~repeated & (measure_shape_quality(mesh) < SMALLEST_SINE)
    remedies = (
        (repeated, "have a node twice: split or delete them in the mesh generator"),
        (duplicate, "repeat an earlier cell: delete them, or export the mesh again without copies"),
        (bad_shape, "are flat, crossed or not convex: correct them in the mesh generator"),
    )
    problems = [f"{_cells(np.flatnonzero(bad))} {remedy}" for bad, remedy in remedies if bad.any()]
    if problems:
        raise InputError(problems)


def _duplicates(ordered: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which rows equal an earlier row."""
    # Stable: of equal rows the earliest comes first.
    order = np.lexsort(ordered.T[::-1])
    in_order = ordered[order]
    same_as_previous = (in_order[1:] == in_order[:-1]).all(axis=1)
    duplicate = np.zeros(len(ordered), dtype=bool)
    duplicate[order[1:][same_as_previous]] = True
    return duplicate


def _cells(numbers: NDArray[np.int64]) -> str:
    """How many cells, and the first of them."""
    return f"{len(numbers)} cells (numbered from 0: {list_first(numbers)})"
