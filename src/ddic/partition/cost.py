"""What a cell costs: the weight by which the mesh is cut and subdomains are dealt to ranks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import rasterize

NODE_PIXELS = 1000.0
"""Work of a node (two unknowns: factors, interface set-up, linear steps) in units of a pixel's (gradient, M,
residuals, the image that is written): bench/cell_costs.py. A larger value balances nodes rather than pixels."""


def estimate_cell_costs(mesh: Mesh) -> NDArray[np.float64]:
    """Estimate the work that each cell brings: its pixels', and its share of its nodes'.

    Nodes at the edge are taken for inner ones, so that equal cells have equal weights and METIS cuts a regular mesh
    regularly.

    Parameters
    ----------
    mesh : Mesh
        Any.

    Returns
    -------
    (n_cells,) array
        Work, in units of a pixel's.
    """
    own_nodes = np.empty(mesh.n_cells)
    for block in mesh.cell_blocks:
        own_nodes[block.cells] = block.type.n_nodes / block.type.cells_around_node
    return np.asarray(rasterize(mesh).pixel_counts + NODE_PIXELS * own_nodes)


def sum_costs(costs: NDArray[np.float64], parts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Add up the work of each subdomain.

    Parameters
    ----------
    costs : (n_cells,) array
        Work of each cell.
    parts : (n_cells,) int64 array
        Subdomain of each cell.

    Returns
    -------
    (n_subdomains,) array
        Work, in the unit of ``costs``.
    """
    return np.asarray(np.bincount(parts, weights=costs), dtype=np.float64)
