"""Area and shape of plane cells, whose nodes are the corners of a polygon.

Areas of what cells cover: of whole cells, or of parts on one side of a discontinuity.
"""

import numba
import numpy as np

from ddic.arrays import Array
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import multiply_across


def measure_areas(mesh: Mesh) -> Array:
    """Measure the cells by the shoelace formula in (x, y): signed areas, square pixels."""
    points = _corners(mesh)
    # Relative to the first corner, so that far from the origin no digits are lost.
    local = points - points[:, :1]
    return np.asarray(0.5 * multiply_across(local, _next_corner(local)).sum(axis=1))


def measure_cell_size(mesh: Mesh) -> float:
    """Measure the size of a mesh's cells, which run positively: the root of their mean area, pixels."""
    return float(np.sqrt(measure_areas(mesh).mean()))


def measure_shape_quality(mesh: Mesh) -> Array:
    """Find the smallest sine of each cell's corner angles.

    It is 1 for a rectangle, <= 0 for a cell that is not convex or runs negatively.
    """
    points = _corners(mesh)
    ahead = _next_corner(points) - points
    behind = _previous_corner(mesh, points) - points
    lengths = np.linalg.norm(ahead, axis=2) * np.linalg.norm(behind, axis=2)
    sines = np.divide(multiply_across(ahead, behind), lengths, out=np.zeros_like(lengths), where=lengths > 0)
    sines[mesh.cells < 0] = np.inf
    return np.asarray(sines.min(axis=1, initial=np.inf))


def _corners(mesh: Mesh) -> Array:
    """Coordinates of the cells' nodes, (n_cells, widest cell, 2); padding repeats the first corner."""
    first = mesh.cells[:, :1]
    cells = np.where(mesh.cells < 0, first, mesh.cells)
    return np.asarray(mesh.nodes[cells])


def _next_corner(points: Array) -> Array:
    """The corner after each one."""
    # The last corner is followed by padding, which repeats the first, or by the first itself.
    return np.roll(points, -1, axis=1)


def _previous_corner(mesh: Mesh, points: Array) -> Array:
    """The corner before each one."""
    counts = np.diff(mesh.offsets)
    previous = np.roll(points, 1, axis=1)
    # Before the first corner comes the last, not the padding.
    previous[:, 0] = points[np.arange(len(points)), counts - 1]
    return previous



def measure_covered_areas(mesh: Mesh) -> tuple[Array, Array]:
    """Measure what each cell covers, square pixels, and its share of the whole cell; cells run positively.

    The share is 1 where no discontinuity cuts the cell.
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
