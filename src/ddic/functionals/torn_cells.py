"""Cells that a displacement tears apart, as one node that is held by nothing does to those around it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.mesh import Mesh, pad_cells

TORN_SIZES, TORN_PIXELS = 4.0, 32.0
"""Sizes of a cell, and pixels beside these, by which displacements of its nodes must differ for it to be torn. No
specimen deforms like that: a cell that turns over differs by two sizes. Larger ones let a node that runs away pull in
more of the image."""


def find_torn_cells(mesh: Mesh, u: NDArray[np.float64]) -> NDArray[np.int64]:
    """Find the cells whose nodes are displaced so differently that their pixels can be nowhere in the image.

    Parameters
    ----------
    mesh : Mesh
        In the image's pixels.
    u : (n_nodes, dim) array
        Displacement, pixels.

    Returns
    -------
    (n,) array of int64
        Their sorted numbers.
    """
    # One component after the other: numpy is slow where it looks for the least of pairs.
    if np.ptp(np.ascontiguousarray(u.T), axis=1).max() <= TORN_PIXELS:
        return np.zeros(0, np.int64)
    cells = pad_cells(mesh)
    size = np.ptp(mesh.nodes[cells], axis=1).max(axis=1)
    difference = np.ptp(u[cells], axis=1).max(axis=1)
    return np.flatnonzero(difference > TORN_PIXELS + TORN_SIZES * size).astype(np.int64)
