"""Repair of a mesh's orientation and numbering; refusal of cells that nothing can be computed on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError, first_of
from ddic.mesh.mesh import Mesh
from ddic.mesh.quality import areas, shape_quality

# Sine of a corner below which a cell is degenerate: far below any mesh generator's, far above rounding.
SMALLEST_SINE = 1e-8


def repair(mesh: Mesh) -> Mesh:
    """Orient all cells positively in (x, y) and drop unused nodes (node sets are renumbered).

    Cells keep their order. Raises InputError, with the cells' numbers, on coordinates that are not finite,
    unknown or repeated nodes, duplicate cells, and cells that are flat, crossed or not convex.
    """
    _refuse_bad_numbers(mesh)
    oriented = _oriented(mesh)
    _refuse_bad_cells(oriented)
    return oriented.submesh(np.arange(mesh.n_cells))[0]


def check_inside(mesh: Mesh, width: int, height: int) -> None:
    """Raise InputError where a node lies outside the image; width, height: its size in pixels."""
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    # Pixel centres are at integers, so the first pixel begins at -0.5; rounding of a mapping is forgiven.
    slack = 1e-6
    if (low >= -0.5 - slack).all() and (high <= np.array([width, height]) - 0.5 + slack).all():
        return
    raise InputError(
        f"the mesh lies outside the image: nodes from ({low[0]:.6g}, {low[1]:.6g}) to "
        f"({high[0]:.6g}, {high[1]:.6g}) px, image {width}x{height} px (from -0.5 to {width - 0.5} and "
        f"{height - 0.5}); correct the region, or mesh.mapping (scale, rotation, translation)")


def check_pixels(mesh: Mesh, pixel_counts: NDArray[np.int64], path: str) -> None:
    """Raise InputError where a cell holds no pixel centre.

    pixel_counts: (n_cells,) pixels of each cell; path: where the mesh comes from, for the message.
    """
    empty = np.flatnonzero(np.asarray(pixel_counts) == 0)
    if len(empty):
        raise InputError(f"{path}: {_cells(empty)} of {mesh.n_cells} hold no pixel: use larger elements, "
                         "or correct the scale from mesh units to pixels")


def _refuse_bad_numbers(mesh: Mesh) -> None:
    if mesh.n_cells == 0:
        raise InputError("the mesh has no cell")
    cells = mesh.cells
    padding = np.arange(cells.shape[1]) >= np.diff(mesh.offsets)[:, None]
    unknown = (((cells < 0) & ~padding) | (cells >= mesh.n_nodes)).any(axis=1)
    if unknown.any():
        raise InputError(f"{_cells(np.flatnonzero(unknown))} name nodes that do not exist "
                         f"(there are {mesh.n_nodes}): export the mesh again")
    used = np.unique(mesh.connectivity)
    wild = used[~np.isfinite(mesh.nodes[used]).all(axis=1)]
    if len(wild):
        raise InputError(f"nodes {first_of(wild)} have coordinates that are not finite numbers")


def _oriented(mesh: Mesh) -> Mesh:
    """Reverse the cells of negative area; the first node stays first."""
    negative = areas(mesh) < 0
    if not negative.any():
        return mesh
    cells, counts = mesh.cells.copy(), np.diff(mesh.offsets)
    for n in np.unique(counts):
        chosen = np.flatnonzero(negative & (counts == n))
        cells[chosen, 1:n] = cells[chosen, 1:n][:, ::-1]
    return Mesh(mesh.nodes, cells[cells >= 0], mesh.offsets, mesh.types, mesh.node_sets, mesh.mapping)


def _refuse_bad_cells(mesh: Mesh) -> None:
    ordered = np.sort(mesh.cells, axis=1)
    repeated = ((ordered[:, 1:] == ordered[:, :-1]) & (ordered[:, 1:] >= 0)).any(axis=1)
    duplicate = _duplicates(ordered)
    bad_shape = ~repeated & (shape_quality(mesh) < SMALLEST_SINE)
    remedies = (
        (repeated, "have a node twice: split or delete them in the mesh generator"),
        (duplicate, "repeat an earlier cell: delete them, or export the mesh again without copies"),
        (bad_shape, "are flat, crossed or not convex: correct them in the mesh generator"),
    )
    problems = [f"{_cells(np.flatnonzero(bad))} {remedy}" for bad, remedy in remedies if bad.any()]
    if problems:
        raise InputError(problems)


def _duplicates(ordered: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Rows equal to an earlier row."""
    order = np.lexsort(ordered.T[::-1])  # stable: of equal rows the earliest comes first
    same = (ordered[order][1:] == ordered[order][:-1]).all(axis=1)
    duplicate = np.zeros(len(ordered), dtype=bool)
    duplicate[order[1:][same]] = True
    return duplicate


def _cells(numbers: NDArray[np.int64]) -> str:
    return f"{len(numbers)} cells (numbered from 0: {first_of(numbers)})"
