"""How firmly the pixels of cells hold their nodes beside a discontinuity: what M's diagonal is without texture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.line_band import list_pixels_outside
from ddic.mesh.interpolation import evaluate_shapes_at
from ddic.mesh.mesh import Mesh


def weigh_corners(mesh: Mesh, cells: NDArray[np.int64], degree: int,
                  active: NDArray[np.uint8] | None = None) -> NDArray[np.float64]:
    """Sum N_a^2 over the pixels of cells that count, for each of their nodes.

    Parameters
    ----------
    mesh : Mesh
        Perhaps with cut cells, pixels of the image.
    cells : (n,) array of int64
        Sorted numbers of those that are weighed.
    degree : int
        Of the spline, 3 or 5: pixels in the band of a line do not count.
    active : (rows, columns) array of uint8, optional
        1 on the pixels of the image that count; all of them by default.

    Returns
    -------
    (len(mesh.connectivity),) array
        For each node of each cell, in the order of the connectivity, pixels; 0 in other cells.
    """
    weights = np.zeros(len(mesh.connectivity))
    if not len(cells):
        return weights
    pixels, cell_of_pixel = list_pixels_outside(mesh, cells, degree)
    if active is not None:
        counted = active[pixels[:, 1], pixels[:, 0]] > 0
        pixels, cell_of_pixel = pixels[counted], cell_of_pixel[counted]
    shapes = evaluate_shapes_at(mesh, cell_of_pixel, pixels.astype(np.float64))
    counts = np.diff(mesh.offsets)
    for corner in range(int(counts.max())):
        has_corner = counts[cell_of_pixel] > corner
        np.add.at(weights, mesh.offsets[cell_of_pixel[has_corner]] + corner, shapes[has_corner, corner] ** 2)
    return weights
