"""Areas of what cells cover: of whole cells, or of parts on one side of a discontinuity."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from ddic.mesh.mesh import Mesh

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


@numba.njit(cache=True)
def _measure_polygons(points, connectivity, offsets):  # type: ignore[no-untyped-def]
    """Areas of polygons, (n,), square pixels."""
    areas = np.zeros(len(offsets) - 1)
    for e in range(len(areas)):
        corners = connectivity[offsets[e]:offsets[e + 1]]
        # Relative to the first corner, so that far from the origin no digits are lost.
        origin_x, origin_y = points[corners[0], 0], points[corners[0], 1]
        for k in range(1, len(corners) - 1):
            one, other = corners[k], corners[k + 1]
            one_x, one_y = points[one, 0] - origin_x, points[one, 1] - origin_y
            other_x, other_y = points[other, 0] - origin_x, points[other, 1] - origin_y
            areas[e] += 0.5 * (one_x * other_y - one_y * other_x)
    return areas
