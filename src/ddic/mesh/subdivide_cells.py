"""Cells cut into many small ones of the same type, each with nodes of its own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.cell_type import T3, CellType
from ddic.mesh.mesh import Mesh, build_mesh

Array = NDArray[np.float64]


def subdivide_cells(mesh: Mesh, cells: NDArray[np.int64], longest: float) -> tuple[Mesh, NDArray[np.int64]]:
    """Cut cells into small ones; nodes on a side that two cells share are there twice.

    Parameters
    ----------
    mesh : Mesh
        Of whole plane cells, T3 or Q4.
    cells : (n,) array of int64
        Numbers of the cells.
    longest : float
        Length that no side of a small cell exceeds where cells are parallelograms, pixels.

    Returns
    -------
    small : Mesh
        Of the small cells.
    cell_of : (small.n_cells,) array of int64
        The cell that each lies in.
    """
    blocks: list[tuple[CellType, NDArray[np.int64]]] = []
    nodes: list[Array] = []
    cell_of: list[NDArray[np.int64]] = []
    n_nodes = 0
    for cell in cells:
        block = next(block for block in mesh.cell_blocks if block.type.vtk == mesh.types[cell])
        corners = mesh.nodes[mesh.cells[cell, :block.type.n_nodes]]
        sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
        n = max(1, int(np.ceil(sides.max() / longest)))
        points, small = _subdivide_triangle(corners, n) if block.type is T3 else _subdivide_quadrilateral(corners, n)
        blocks.append((block.type, small + n_nodes))
        nodes.append(points)
        cell_of.append(np.full(len(small), cell, dtype=np.int64))
        n_nodes += len(points)
    return build_mesh(np.concatenate(nodes), blocks), np.concatenate(cell_of)


def _subdivide_quadrilateral(corners: Array, n: int) -> tuple[Array, NDArray[np.int64]]:
    """Nodes ((n + 1)^2, 2) and cells (n^2, 4) of a grid in a quadrilateral."""
    shares = np.arange(n + 1) / n
    below = _divide_side(corners[0], corners[1], shares)
    above = _divide_side(corners[3], corners[2], shares)
    points = np.stack([_divide_side(below, above, np.array([share]))[0] for share in shares])
    numbers = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    cells = np.stack([numbers[:-1, :-1], numbers[:-1, 1:], numbers[1:, 1:], numbers[1:, :-1]], axis=-1)
    return points.reshape(-1, 2), cells.reshape(-1, 4)


def _subdivide_triangle(corners: Array, n: int) -> tuple[Array, NDArray[np.int64]]:
    """Nodes and cells (n^2, 3) of a grid in a triangle."""
    left = _divide_side(corners[0], corners[2], np.arange(n + 1) / n)
    right = _divide_side(corners[1], corners[2], np.arange(n + 1) / n)
    rows = [_divide_side(left[k], right[k], np.arange(n - k + 1) / max(n - k, 1)) for k in range(n + 1)]
    first = np.cumsum([0, *(len(row) for row in rows)])
    cells = []
    for k in range(n):
        here, next_row = first[k], first[k + 1]
        for i in range(n - k):
            cells.append([here + i, here + i + 1, next_row + i])
            if i + 1 < n - k:
                cells.append([here + i + 1, next_row + i + 1, next_row + i])
    return np.concatenate(rows), np.array(cells, dtype=np.int64)


def _divide_side(start: Array, end: Array, shares: Sequence[float] | Array) -> Array:
    """Points at shares of the way; exactly on a side that runs along an axis, and at its ends."""
    # Else a pixel on such a side could count twice, or not at all.
    along = np.asarray(shares)[:, *[None] * start.ndim]
    return np.asarray(np.where(along == 1.0, end, start + along * (end - start)))
