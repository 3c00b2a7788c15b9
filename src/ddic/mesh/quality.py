"""Size, shape and corners of cells, whose nodes are corners; areas of parts on one side of a discontinuity."""

from dataclasses import dataclass

import numba
import numpy as np

from ddic.arrays import Array, IntArray
from ddic.mesh.mesh import Mesh, compute_determinants, compute_shape_gradients


def measure_areas(mesh: Mesh) -> Array:
    """Measure the whole cells: signed areas in (x, y), or in a volume their volumes; pixels to the power dim."""
    if mesh.dim == 2:
        return np.asarray(_measure_polygons(*mesh.whole_outlines))
    volumes = np.empty(mesh.n_cells)
    for block in mesh.cell_blocks:
        _, det = compute_shape_gradients(mesh, block, block.type.quadrature.points)
        volumes[block.cells] = det @ block.type.quadrature.weights
    return volumes


def measure_cell_size(mesh: Mesh) -> float:
    """Measure the size of a mesh's cells, which run positively: the side of a square or cube like the mean, pixels."""
    return float(measure_areas(mesh).mean() ** (1 / mesh.dim))


def measure_shape_quality(mesh: Mesh) -> Array:
    """Find the least sine of each cell's corners: 1 of a rectangle, <= 0 where it is not convex or runs negatively.

    In a volume it is what the edges of a corner, made one long, span.
    """
    edges = list_corner_edges(mesh, mesh.nodes)
    lengths = np.linalg.norm(edges, axis=2).prod(axis=1)
    sines = np.divide(compute_determinants(edges), lengths, out=np.zeros_like(lengths), where=lengths > 0)
    return np.asarray(np.minimum.reduceat(sines, mesh.offsets[:-1]))


@dataclass(frozen=True, eq=False)
class Corners:
    """Corners of cells, cell after cell.

    Attributes
    ----------
    cells, nodes : (n,) array of int64
        Each corner's cell and node.
    ends : (n, dim) array of int64
        The nodes at the other ends of the edges that leave it, positively ordered: in the plane the cell's nodes after
        and before it.
    """

    cells: IntArray
    nodes: IntArray
    ends: IntArray


def list_corners(mesh: Mesh) -> Corners:
    """List the corners of all cells, in the order of the cells' nodes."""
    cells = np.repeat(np.arange(mesh.n_cells), np.diff(mesh.offsets))
    ends = np.empty((len(cells), mesh.dim), dtype=np.int64)
    for block in mesh.cell_blocks:
        places = mesh.offsets[block.cells][:, None] + np.arange(block.type.n_nodes)
        ends[places] = block.nodes[:, block.type.corner_edges]
    return Corners(cells, mesh.connectivity, ends)


def list_corner_edges(mesh: Mesh, values: Array) -> Array:
    """List differences of nodal values, (n_nodes, k), along the edges that leave each corner, (n_corners, dim, k)."""
    corners = list_corners(mesh)
    return np.asarray(values[corners.ends] - values[corners.nodes][:, None])


def measure_covered_areas(mesh: Mesh) -> tuple[Array, Array]:
    """Measure what each positively run cell covers, square pixels, and its share of the whole cell, 1 where not cut."""
    if mesh.parts is None:
        return measure_areas(mesh), np.ones(mesh.n_cells)
    areas = _measure_polygons(*mesh.outlines)
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
