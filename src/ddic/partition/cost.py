"""What a cell costs: the weight by which the mesh is cut and subdomains are dealt to ranks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import rasterize

NODE_PIXELS = 1000.0
"""Work of a node (two unknowns: factors, interface set-up, linear steps) in units of a pixel's (gradient, M,
residuals, the image that is written): bench/cell_costs.py."""

CELLS_A_NODE = {3: 6.0, 4: 4.0}
"""Cells around an inner node, by the nodes of a cell: 6 T3 or 4 Q4. Taken for nodes at the edge as well, so that equal
cells have equal weights and METIS cuts a regular mesh regularly."""


def cell_costs(mesh: Mesh) -> NDArray[np.float64]:
    """Work that each cell brings, in pixels: its own, and its share of its nodes', (n_cells,)."""
    n_nodes = np.diff(mesh.offsets)
    shares = np.zeros(mesh.n_cells)
    for n, n_cells in CELLS_A_NODE.items():
        shares[n_nodes == n] = n / n_cells
    return np.asarray(rasterize(mesh).pixel_counts + NODE_PIXELS * shares)


def subdomain_costs(costs: NDArray[np.float64], parts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Work of each subdomain, (n_subdomains,); costs, parts: work and subdomain of each cell, (n_cells,)."""
    return np.asarray(np.bincount(parts, weights=costs), dtype=np.float64)
