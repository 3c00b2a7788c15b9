"""Areas of what cells cover: of whole cells, or of parts on one side of a discontinuity."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import multiply_across

Array = NDArray[np.float64]


def measure_covered_areas(mesh: Mesh) -> tuple[Array, Array]:
    """Measure what each cell covers.

    Parameters
    ----------
    mesh : Mesh
        Of plane cells that run positively.

    Returns
    -------
    areas : (n_cells,) array
        Square pixels.
    shares : (n_cells,) array
        Of the whole cell; 1 where no discontinuity cuts it.
    """
    outlines = mesh.outlines
    areas = _measure_polygons(outlines.corners, outlines.connectivity, outlines.offsets)
    if mesh.parts is None:
        return areas, np.ones(mesh.n_cells)
    return areas, areas / _measure_polygons(mesh.nodes, mesh.connectivity, mesh.offsets)


def _measure_polygons(points: Array, connectivity: NDArray[np.int64], offsets: NDArray[np.int64]) -> Array:
    """Areas of polygons, (n,), square pixels."""
    counts = np.diff(offsets)
    first = np.repeat(offsets[:-1], counts)
    place = np.arange(len(connectivity)) - first
    ahead = first + (place + 1) % np.repeat(counts, counts)
    # Relative to the first corner, so that far from the origin no digits are lost.
    corners = points[connectivity] - points[connectivity[first]]
    return np.asarray(0.5 * np.add.reduceat(multiply_across(corners, corners[ahead]), offsets[:-1]))
