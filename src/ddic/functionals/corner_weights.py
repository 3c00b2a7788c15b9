"""How firmly the pixels of cells hold their nodes beside a discontinuity: what M's diagonal is without texture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.line_band import list_pixels_outside
from ddic.mesh.cut_mesh import CutMesh
from ddic.mesh.interpolation import evaluate_shapes_at


def weigh_corners(cut: CutMesh, degree: int, active: NDArray[np.uint8] | None = None) -> NDArray[np.float64]:
    """Sum N_a^2 over the pixels of cells that count, for each of their nodes.

    Parameters
    ----------
    cut : CutMesh
        With its lines.
    degree : int
        Of the spline, 3 or 5: pixels in the band of a line do not count.
    active : (rows, columns) array of uint8, optional
        1 on the pixels of the image that count; all of them by default.

    Returns
    -------
    (len(cut.mesh.connectivity),) array
        For each node of each cell, in the order of the connectivity, pixels; 0 in cells none of whose nodes has a
        phantom.
    """
    mesh = cut.mesh
    weights = np.zeros(len(mesh.connectivity))
    has_twin = np.bincount(cut.node_of)[cut.node_of] > 1
    beside = np.flatnonzero(np.add.reduceat(has_twin[mesh.connectivity], mesh.offsets[:-1]) > 0).astype(np.int64)
    if not len(beside):
        return weights
    pixels, cells = list_pixels_outside(mesh, beside, degree)
    if active is not None:
        counted = active[pixels[:, 1], pixels[:, 0]] > 0
        pixels, cells = pixels[counted], cells[counted]
    shapes = evaluate_shapes_at(mesh, cells, pixels.astype(np.float64))
    counts = np.diff(mesh.offsets)
    for corner in range(int(counts.max())):
        has_corner = counts[cells] > corner
        np.add.at(weights, mesh.offsets[cells[has_corner]] + corner, shapes[has_corner, corner] ** 2)
    return weights
