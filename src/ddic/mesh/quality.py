"""Area, shape and corners of plane cells, whose nodes are corners; areas of parts on one side of a discontinuity."""

from dataclasses import dataclass

import numba
import numpy as np

from ddic.arrays import Array, IntArray
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import multiply_across


def measure_areas(mesh: Mesh) -> Array:
    """Measure the whole cells by the shoelace formula in (x, y): signed areas, square pixels."""
    return np.asarray(_measure_polygons(*mesh.whole_outlines))


def measure_cell_size(mesh: Mesh) -> float:
    """Measure the size of a mesh's cells, which run positively: the root of their mean area, pixels."""
    return float(np.sqrt(measure_areas(mesh).mean()))


def measure_shape_quality(mesh: Mesh) -> Array:
    """Find the least sine of each cell's corners: 1 of a rectangle, <= 0 where it is not convex or runs negatively."""
    ahead, behind = list_corner_edges(mesh, mesh.nodes)
    lengths = np.linalg.norm(ahead, axis=1) * np.linalg.norm(behind, axis=1)
    sines = np.divide(multiply_across(ahead, behind), lengths, out=np.zeros_like(lengths), where=lengths > 0)
    return np.asarray(np.minimum.reduceat(sines, mesh.offsets[:-1]))


@dataclass(frozen=True, eq=False)
class Corners:
    """Corners of plane cells, cell after cell.

    Attributes
    ----------
    cells, nodes : (n,) array of int64
        Each corner's cell and node.
    ahead, behind : (n,) array of int64
        The cell's nodes after and before it.
    """

    cells: IntArray
    nodes: IntArray
    ahead: IntArray
    behind: IntArray


def list_corners(mesh: Mesh) -> Corners:
    """List the corners of all cells, in the order of the cells' nodes; cells are plane, with their nodes as corners."""
    counts = np.diff(mesh.offsets)
    cells = np.repeat(np.arange(mesh.n_cells), counts)
    first_of_cell, n_of_cell = mesh.offsets[cells], counts[cells]
    place = np.arange(len(cells)) - first_of_cell
    ahead = first_of_cell + (place + 1) % n_of_cell
    behind = first_of_cell + (place - 1) % n_of_cell
    return Corners(cells, mesh.connectivity, mesh.connectivity[ahead], mesh.connectivity[behind])


def list_corner_edges(mesh: Mesh, values: Array) -> tuple[Array, Array]:
    """List differences of nodal values, (n_nodes, k), from each corner of each cell to the next and the one before.

    (n_corners, k) each; cells are plane, with their nodes as corners.
    """
    corners = list_corners(mesh)
    at_corners = values[corners.nodes]
    return values[corners.ahead] - at_corners, values[corners.behind] - at_corners


def measure_covered_areas(mesh: Mesh) -> tuple[Array, Array]:
    """Measure what each positively run cell covers, square pixels, and its share of the whole cell, 1 where not cut."""
    areas = _measure_polygons(*mesh.outlines)
    if mesh.parts is None:
        return areas, np.ones(mesh.n_cells)
    return areas, areas / measure_areas(mesh)


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
