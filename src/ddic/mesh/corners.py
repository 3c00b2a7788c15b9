"""Corners of cells, each with its neighbours along the cell's edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.mesh import Mesh


@dataclass(frozen=True, eq=False)
class Corners:
    """Corners of plane cells, cell after cell.

    Attributes
    ----------
    cells : (n,) array of int64
        Number of each corner's cell.
    nodes : (n,) array of int64
        Its node.
    ahead, behind : (n,) array of int64
        The cell's nodes after and before it.
    """

    cells: NDArray[np.int64]
    nodes: NDArray[np.int64]
    ahead: NDArray[np.int64]
    behind: NDArray[np.int64]


def list_corners(mesh: Mesh) -> Corners:
    """List the corners of all cells.

    Parameters
    ----------
    mesh : Mesh
        Of plane cells whose corners are their nodes.

    Returns
    -------
    Corners
        In the order of the cells' nodes.
    """
    counts = np.diff(mesh.offsets)
    cells = np.repeat(np.arange(mesh.n_cells), counts)
    first_of_cell, n_of_cell = mesh.offsets[cells], counts[cells]
    place = np.arange(len(cells)) - first_of_cell
    ahead = first_of_cell + (place + 1) % n_of_cell
    behind = first_of_cell + (place - 1) % n_of_cell
    return Corners(cells, mesh.connectivity, mesh.connectivity[ahead], mesh.connectivity[behind])
