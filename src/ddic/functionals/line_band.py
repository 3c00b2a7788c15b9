"""Pixels near a discontinuity, where g jumps and its spline rings, and how firmly the others hold nodes beside it."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, IntArray
from ddic.mesh.interpolation import evaluate_shapes_at
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import is_inside_polygon, measure_distance
from ddic.mesh.raster import Raster, find_common_pixels, list_pixels, rasterize

BAND = {3: 2.0, 5: 3.0}
"""Distance, pixels, from a line within which pixels do not count, by degree of the spline: as far as its taps reach. A
larger one loses pixels, within a smaller one the other side is interpolated."""


def find_band_pixels(mesh: Mesh, raster: Raster, degree: int) -> tuple[IntArray, IntArray]:
    """Find the pixels of a mesh that lie within the band of a line, or between its bends and what cuts the cells.

    Gives their columns and rows, (n, 2), and the cell of each, (n,). ``degree`` is that of the spline, 3 or 5.
    """
    if mesh.parts is None:
        return np.zeros((0, 2), np.int64), np.zeros(0, np.int64)
    width = BAND[degree]
    lines = mesh.parts.lines
    near = _find_near_cells(mesh, (*lines.polylines, *lines.bends), width)
    pixels, cells = list_pixels(raster, near)
    points = pixels.astype(np.float64)
    inside = np.zeros(len(points), dtype=bool)
    for line in lines.polylines:
        inside |= measure_distance(points, line) <= width
    for bend in lines.bends:
        inside |= is_inside_polygon(points, bend)
    return pixels[inside], cells[inside]


def list_pixels_outside(mesh: Mesh, cells: IntArray, degree: int) -> tuple[IntArray, IntArray]:
    """List the pixels of some cells, given by sorted numbers, that lie beyond the band of all lines.

    Gives their columns and rows, (n, 2), and the cell of each, (n,); nothing else of the mesh is rasterised. ``degree``
    is that of the spline, 3 or 5.
    """
    part, _ = mesh.create_submesh(cells)
    raster = rasterize(part)
    pixels, own = list_pixels(raster, np.arange(part.n_cells))
    in_band, _ = find_band_pixels(part, raster, degree)
    outside = ~find_common_pixels(pixels, in_band)
    return pixels[outside], cells[own[outside]]


def _find_near_cells(mesh: Mesh, lines: Sequence[Array], width: float) -> IntArray:
    """Cells that may have a pixel in the band."""
    outlines = mesh.outlines
    corners = outlines.corners[outlines.connectivity]
    centres = np.repeat(mesh.centroids, np.diff(outlines.offsets), axis=0)
    radius = np.maximum.reduceat(np.linalg.norm(corners - centres, axis=1), outlines.offsets[:-1])
    near = np.zeros(mesh.n_cells, dtype=bool)
    for line in lines:
        near |= measure_distance(mesh.centroids, line) <= radius + width
    return np.flatnonzero(near).astype(np.int64)


def weigh_corners(mesh: Mesh, cells: IntArray, degree: int, active: NDArray[np.uint8] | None = None) -> Array:
    """Sum N_a^2 over the pixels of some cells that count, for each of their nodes.

    Sums, in pixels, stand for each node of each cell in the order of the connectivity, (len(mesh.connectivity),); 0 in
    cells that are not among the sorted numbers ``cells``. ``degree`` is that of the spline, 3 or 5: pixels in the band
    of a line do not count. ``active`` is 1 on the pixels of the image that count, (rows, columns); all of them by
    default.
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
