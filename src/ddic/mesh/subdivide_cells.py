"""Cells cut into many small ones of the same type, each with nodes of its own."""

from __future__ import annotations

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
        cell_type = next(block.type for block in mesh.cell_blocks if block.type.vtk == mesh.types[cell])
        corners = mesh.nodes[mesh.cells[cell, :cell_type.n_nodes]]
        sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
        n = max(1, int(np.ceil(sides.max() / longest)))
        subdivide = _subdivide_triangle if cell_type is T3 else _subdivide_quadrilateral
        points, small = subdivide(corners, n)
        blocks.append((cell_type, small + n_nodes))
        nodes.append(points)
        cell_of.append(np.full(len(small), cell, dtype=np.int64))
        n_nodes += len(points)
    return build_mesh(np.concatenate(nodes), blocks), np.concatenate(cell_of)


def _subdivide_quadrilateral(corners: Array, n: int) -> tuple[Array, NDArray[np.int64]]:
    """Nodes ((n + 1)^2, 2) and cells (n^2, 4) of a grid in a quadrilateral, of n cells a side."""
    shares = np.arange(n + 1) / n
    below = _divide(corners[0], corners[1], shares)
    above = _divide(corners[3], corners[2], shares)
    rows = _divide(below, above, shares)
    numbers = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    cells = np.stack([numbers[:-1, :-1], numbers[:-1, 1:], numbers[1:, 1:], numbers[1:, :-1]], axis=-1)
    return rows.reshape(-1, 2), cells.reshape(-1, 4)


def _subdivide_triangle(corners: Array, n: int) -> tuple[Array, NDArray[np.int64]]:
    """Nodes and cells (n^2, 3) of a grid in a triangle, of n cells a side."""
    left = _divide(corners[0], corners[2], np.arange(n + 1) / n)
    right = _divide(corners[1], corners[2], np.arange(n + 1) / n)
    # One cell fewer in each row; the last is the triangle's third corner alone.
    n_of_rows = range(n, -1, -1)
    rows = [_divide(left[k], right[k], np.arange(n_of_row + 1) / max(n_of_row, 1))
            for k, n_of_row in enumerate(n_of_rows)]
    first = np.cumsum([0, *(len(row) for row in rows)])
    cells = []
    for k in range(n):
        here, beyond = first[k], first[k + 1]
        for i in range(n_of_rows[k]):
            cells.append([here + i, here + i + 1, beyond + i])
            if i + 1 < n_of_rows[k]:
                # Between two of those, the other way up.
                cells.append([here + i + 1, beyond + i + 1, beyond + i])
    return np.concatenate(rows), np.array(cells, dtype=np.int64)


def _divide(start: Array, end: Array, shares: Array) -> Array:
    """Points at shares of the way from start to end, one after the other: (n_shares, *start.shape).

    They lie exactly on a way along an axis and at its ends: a pixel there would else count twice, or not at all.
    """
    along = np.expand_dims(shares, tuple(range(1, start.ndim + 1)))
    return np.asarray(np.where(along == 1.0, end, start + along * (end - start)))
