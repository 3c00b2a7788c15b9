"""Values at any point of a mesh, by the shape functions of the cell that holds it; which points lie in which cells."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numba
import numpy as np
from scipy import sparse

from ddic.arrays import Array, BoolArray, IntArray
from ddic.mesh.cell_type import TET4, differentiate_monomials, evaluate_monomials
from ddic.mesh.mesh import Mesh, compute_geometry, pad_cells, pad_shapes
from ddic.mesh.plane import is_inside_edges, multiply_across
from ddic.mesh.topology import find_boundary_facets

EDGE = 1e-6
"""Distance, pixels, by which a point may lie outside a cell and still be found in it: rounding of coordinates. A larger
value extrapolates farther; holes narrower than twice this are bridged."""

CELLS_A_BUCKET = 1.0
"""Mean number of cells a bucket of the search grid holds, if all were alike; a larger value takes less memory, and
longer a point."""


AT_OTHER_NODES = 1e-9
"""Shape function of a node below which a point lies on others."""


@dataclass(frozen=True)
class Located:
    """Where points lie in a mesh.

    Attributes
    ----------
    cells : (n,) int64 array
        The cell that holds each point, -1 outside the mesh and in its holes.
    local : (n, dim) array
        The points in their reference cells, nan where there is no cell.
    """

    cells: IntArray
    local: Array


class _Buckets(NamedTuple):
    """A grid of squares or cubes over a mesh, and the cells whose bounding boxes touch each, in ascending order.

    low: (dim,) corner of the grid, pixels; size: of a square or a cube, pixels; counts: (3,) of them along x, y and z,
    one along z in the plane; bucket k, numbered row by row, holds cells[first[k]:first[k + 1]].
    """

    low: Array
    size: float
    counts: IntArray
    first: IntArray
    cells: IntArray


class _ShapesInSpace(NamedTuple):
    """Where cells in space lie: X of eight monomials, (n, 3, 8), corners of boxes, (n, 3), whether each is a Tet4."""

    geometry: Array
    lowest: Array
    highest: Array
    is_tet: BoolArray


def interpolate(mesh: Mesh, values: Array, points: Array) -> Array:
    """Interpolate nodal values, (n_nodes, k), at points, pixels, never across a hole.

    The result, (n, k), is nan outside the mesh and in its holes. Cells must be convex and run positively, as ``repair``
    leaves them.
    """
    return interpolate_located(mesh, values, locate(mesh, points))


def interpolate_located(mesh: Mesh, values: Array, located: Located) -> Array:
    """Interpolate nodal values, (n_nodes, k), of many fields at the same points, (n, k), nan outside all cells."""
    found = np.full((len(located.cells), values.shape[1]), np.nan)
    held = located.cells >= 0
    types = np.zeros(len(located.cells), dtype=mesh.types.dtype)
    types[held] = mesh.types[located.cells[held]]
    for block in mesh.cell_blocks:
        members = np.flatnonzero(types == block.type.vtk)
        shapes = block.type.evaluate_shapes(located.local[members])
        nodes = mesh.cells[located.cells[members]]
        total = np.zeros((len(members), values.shape[1]))
        for a in range(block.type.n_nodes):
            share = shapes[:, a, None] * values[nodes[:, a]]
            # A node without a value says nothing of points on the other nodes.
            unknown_elsewhere = np.isnan(share) & (np.abs(shapes[:, a, None]) < AT_OTHER_NODES)
            total += np.where(unknown_elsewhere, 0.0, share)
        found[members] = total
    return found


def evaluate_shapes_at(mesh: Mesh, cells: IntArray, points: Array) -> Array:
    """Evaluate shape functions at points, pixels, in given cells, (n, n_monomials); zero for a node it lacks."""
    monomials = evaluate_monomials(place_in_cells(mesh, cells, points).local, mesh.n_monomials)
    shapes = np.zeros((len(points), mesh.n_monomials))
    for block in mesh.cell_blocks:
        members = mesh.types[cells] == block.type.vtk
        shapes[members] = monomials[members] @ pad_shapes(block.type, mesh.n_monomials).T
    return shapes


def weigh_nodes_at(mesh: Mesh, cells: IntArray, points: Array) -> sparse.csr_matrix:
    """Give shape functions at points, pixels, in given cells as factors of the nodes' values, (n, n_nodes)."""
    shapes = evaluate_shapes_at(mesh, cells, points)
    rows = np.repeat(np.arange(len(points)), shapes.shape[1])
    return sparse.csr_matrix((shapes.ravel(), (rows, pad_cells(mesh)[cells].ravel())), (len(points), mesh.n_nodes))


def differentiate_shapes_at(mesh: Mesh, cells: IntArray, points: Array) -> Array:
    """Differentiate shape functions at points in cells, dN_a / dx_j, (n, n_monomials, dim), 1/px."""
    by_local = differentiate_monomials(place_in_cells(mesh, cells, points).local, mesh.n_monomials)
    jacobian = np.einsum("pim,pmj->pij", compute_geometry(mesh)[cells], by_local)
    by_x = by_local @ np.linalg.inv(jacobian)
    gradients = np.zeros((len(points), mesh.n_monomials, mesh.dim))
    for block in mesh.cell_blocks:
        members = mesh.types[cells] == block.type.vtk
        gradients[members] = np.einsum("am,pmj->paj", pad_shapes(block.type, mesh.n_monomials), by_x[members])
    return gradients


def locate(mesh: Mesh, points: Array) -> Located:
    """Find the cells that hold points, (n, dim), pixels, and the points' places in them.

    A point on an edge or a node belongs to one of the cells there, the first of those that hold it. Cells must be
    convex and run positively, as ``repair`` leaves them.
    """
    return CellSearch(mesh).locate(points)


@dataclass(frozen=True, eq=False)
class CellSearch:
    """A mesh whose cells are sorted by where they are: once, for many searches.

    Attributes
    ----------
    mesh : Mesh
        Its cells are convex and run positively.
    """

    mesh: Mesh

    @cached_property
    def _buckets(self) -> _Buckets:
        return _sort_into_buckets(self.mesh)

    def locate(self, points: Array) -> Located:
        """Find the cells that hold points, as ``locate`` does."""
        points = np.ascontiguousarray(points, dtype=np.float64)
        cells = np.full(len(points), -1, dtype=np.int64)
        if self.mesh.n_cells and self.mesh.dim == 3:
            _find_cells_in_space(points, self._shapes_in_space, self._buckets, EDGE, cells)
        elif self.mesh.n_cells:
            _find_cells(points, self.mesh.outlines, self._buckets, EDGE, cells)
        return place_in_cells(self.mesh, cells, points)

    @cached_property
    def _shapes_in_space(self) -> _ShapesInSpace:
        lowest, highest = self.mesh.outlines.find_boxes()
        return _ShapesInSpace(_pad_geometry(compute_geometry(self.mesh)), lowest, highest, self.mesh.types == TET4.vtk)

    def list_near(self, point: tuple[float, float]) -> IntArray:
        """List the plane cells, sorted, that reach within about two mean sizes of a cell from a point, pixels."""
        buckets = self._buckets
        column, row = np.floor((np.array(point) - buckets.low) / buckets.size).astype(int)
        columns, rows, _ = buckets.counts
        begin, end = np.clip([column - 2, column + 3], 0, columns)
        near = [np.zeros(0, np.int64)]
        for k in range(max(row - 2, 0), min(row + 3, rows)):
            first, last = buckets.first[k * columns + np.array([begin, end])]
            near.append(buckets.cells[first:last])
        return np.unique(np.concatenate(near))


def place_in_cells(mesh: Mesh, cells: IntArray, points: Array) -> Located:
    """Place points, pixels, in given convex cells, -1 for none, or beyond them: shape functions go on outside."""
    local = np.full(points.shape, np.nan)
    is_held = np.zeros(mesh.n_cells, dtype=bool)
    is_held[cells[cells >= 0]] = True
    held = np.flatnonzero(is_held)
    if len(held):
        numbers = np.cumsum(is_held) - 1
        of_points, geometry = np.where(cells < 0, -1, numbers[cells]), compute_geometry(mesh, held)
        if mesh.dim == 3:
            _find_local_coordinates_in_space(points, of_points, _pad_geometry(geometry), local)
        else:
            _find_local_coordinates(points, of_points, geometry, local)
    return Located(cells, local)


def _sort_into_buckets(mesh: Mesh) -> _Buckets:
    """Sort a mesh's cells into a grid of about as many squares or cubes."""
    lowest, highest = mesh.outlines.find_boxes()
    lowest, highest = lowest - EDGE, highest + EDGE
    low, high = lowest.min(axis=0), highest.max(axis=0)
    size = float((np.prod(high - low) * CELLS_A_BUCKET / mesh.n_cells)**(1 / mesh.dim))
    counts, begin = np.ones(3, np.int64), np.zeros((mesh.n_cells, 3), np.int64)
    end = begin + 1
    counts[:mesh.dim] = (high - low) / size + 1.0
    begin[:, :mesh.dim] = (lowest - low) / size
    end[:, :mesh.dim] = (highest - low) / size + 1.0
    first, cells = _fill_buckets(begin, end, counts)
    return _Buckets(low, size, counts, first, cells)


@numba.njit(cache=True)
def _fill_buckets(begin, end, counts):  # type: ignore[no-untyped-def]
    """Cells by bucket, from the half-open ranges along x, y and z that each cell's bounding box touches."""
    columns, rows, planes = counts
    first = np.zeros(columns * rows * planes + 1, dtype=np.int64)
    for e in range(len(begin)):
        for plane in range(begin[e, 2], end[e, 2]):
            for row in range(begin[e, 1], end[e, 1]):
                for column in range(begin[e, 0], end[e, 0]):
                    first[(plane * rows + row) * columns + column + 1] += 1
    first = np.cumsum(first)
    cells = np.empty(first[-1], dtype=np.int64)
    place = first[:-1].copy()
    for e in range(len(begin)):
        for plane in range(begin[e, 2], end[e, 2]):
            for row in range(begin[e, 1], end[e, 1]):
                for column in range(begin[e, 0], end[e, 0]):
                    bucket = (plane * rows + row) * columns + column
                    cells[place[bucket]] = e
                    place[bucket] += 1
    return first, cells


# A damaged result may hold an edge between two nodes at one place: 0 / 0 is nan, and its cell holds no point.
@numba.njit(cache=True, error_model="numpy")
def _depth(x, y, e, outlines):  # type: ignore[no-untyped-def]
    """Least signed distance of a point from the lines through a convex cell's edges, positive inside."""
    nodes = outlines.corners
    begin, end = outlines.offsets[e], outlines.offsets[e + 1]
    least = np.inf
    b = outlines.connectivity[end - 1]
    for i in range(begin, end):
        a, b = b, outlines.connectivity[i]
        along_x, along_y = nodes[b, 0] - nodes[a, 0], nodes[b, 1] - nodes[a, 1]
        across = along_x * (y - nodes[a, 1]) - along_y * (x - nodes[a, 0])
        least = min(least, across / np.sqrt(along_x * along_x + along_y * along_y))
    return least


@numba.njit(cache=True)
def _find_cells(points, outlines, buckets, edge, cells):  # type: ignore[no-untyped-def]
    """The first cell that holds each point, or else the nearest one within the distance ``edge``."""
    for k in range(len(points)):
        x, y = points[k, 0], points[k, 1]
        # Compared before they are whole numbers, so that nan and infinity are nowhere.
        column, row = (x - buckets.low[0]) / buckets.size, (y - buckets.low[1]) / buckets.size
        if not (0.0 <= column < buckets.counts[0] and 0.0 <= row < buckets.counts[1]):
            continue
        bucket = int(row) * buckets.counts[0] + int(column)
        deepest = -edge
        for i in range(buckets.first[bucket], buckets.first[bucket + 1]):
            e = buckets.cells[i]
            depth = _depth(x, y, e, outlines)
            if depth >= deepest:
                cells[k] = e
                deepest = depth
            if depth >= 0.0:
                break


@numba.njit(cache=True)
def _find_local_coordinates(points, cells, geometry, local):  # type: ignore[no-untyped-def]
    """Invert x = X_0 + e xi + f eta + g xi eta of each point's cell; e, f, g: the rows of its geometry.

    With h = x - X_0, the products of the equation with e + g eta and with f + g xi are quadratic in eta and in xi
    alone. Both are divided by e x f, so that they read s = 1 in an affine cell, and solved for the root that stays
    finite where the quadratic terms vanish.
    """
    for k in range(len(points)):
        cell = cells[k]
        if cell < 0:
            continue
        X, Y = geometry[cell, 0], geometry[cell, 1]
        hx, hy = points[k, 0] - X[0], points[k, 1] - Y[0]
        area = X[1] * Y[2] - Y[1] * X[2]
        he = (hx * Y[1] - hy * X[1]) / area
        hf = (hx * Y[2] - hy * X[2]) / area
        hg = (hx * Y[3] - hy * X[3]) / area
        gf = (X[3] * Y[2] - Y[3] * X[2]) / area
        s = np.sqrt(max((1.0 + hg) * (1.0 + hg) - 4.0 * gf * he, 0.0))
        local[k, 0] = 2.0 * hf / (1.0 - hg + s)
        local[k, 1] = -2.0 * he / (1.0 + hg + s)


NEWTON_STEPS = 30
"""Steps at most by which a place in a warped cell in space is sought; a few find it in the cell."""

CLOSE = 1e-9
"""Step of local coordinates that is the last one: the next would be as its square."""


def _pad_geometry(geometry: Array) -> Array:
    """X with eight monomials, of which tetrahedra need four."""
    return np.pad(geometry, ((0, 0), (0, 0), (0, 8 - geometry.shape[2])))


@numba.njit(cache=True)
def _map_to_axis(X, xi, eta, zeta):  # type: ignore[no-untyped-def]
    """A coordinate of a point of a cell, and its slopes by the local ones."""
    value = (X[0] + X[1] * xi + X[2] * eta + X[3] * zeta
             + X[4] * xi * eta + X[5] * xi * zeta + X[6] * eta * zeta + X[7] * xi * eta * zeta)
    return (value, X[1] + X[4] * eta + X[5] * zeta + X[7] * eta * zeta,
            X[2] + X[4] * xi + X[6] * zeta + X[7] * xi * zeta, X[3] + X[5] * xi + X[6] * eta + X[7] * xi * eta)


@numba.njit(cache=True, error_model="numpy")
def _invert_map(X, point):  # type: ignore[no-untyped-def]
    """Solve x = sum X_m phi_m(xi) by Newton's method: xi, (3,), and the rows d xi_k / dx there, three times (3,)."""
    xi, eta, zeta = 0.0, 0.0, 0.0
    for _ in range(NEWTON_STEPS):
        x, a, b, c = _map_to_axis(X[0], xi, eta, zeta)
        y, d, f, g = _map_to_axis(X[1], xi, eta, zeta)
        z, h, i, j = _map_to_axis(X[2], xi, eta, zeta)
        x, y, z = point[0] - x, point[1] - y, point[2] - z
        det = a * (f * j - g * i) + b * (g * h - d * j) + c * (d * i - f * h)
        first = (f * j - g * i) / det, (c * i - b * j) / det, (b * g - c * f) / det
        second = (g * h - d * j) / det, (a * j - c * h) / det, (c * d - a * g) / det
        third = (d * i - f * h) / det, (b * h - a * i) / det, (a * f - b * d) / det
        d_xi = first[0] * x + first[1] * y + first[2] * z
        d_eta = second[0] * x + second[1] * y + second[2] * z
        d_zeta = third[0] * x + third[1] * y + third[2] * z
        xi, eta, zeta = xi + d_xi, eta + d_eta, zeta + d_zeta
        if abs(d_xi) + abs(d_eta) + abs(d_zeta) < CLOSE:
            break
    return (xi, eta, zeta), first, second, third


@numba.njit(cache=True)
def _find_local_coordinates_in_space(points, cells, geometry, local):  # type: ignore[no-untyped-def]
    """Local coordinates of each point in its cell; none where that is -1."""
    for k in range(len(points)):
        if cells[k] >= 0:
            local[k, 0], local[k, 1], local[k, 2] = _invert_map(geometry[cells[k]], points[k])[0]


@numba.njit(cache=True, error_model="numpy")
def _measure_depth_in_space(X, point, is_tet):  # type: ignore[no-untyped-def]
    """Least signed distance of a point near a cell from the cell's faces, positive inside, to first order."""
    (xi, eta, zeta), (a, b, c), (d, f, g), (h, i, j) = _invert_map(X, point)
    # From faces, in local coordinates, over the lengths of these coordinates' gradients.
    of_xi, of_eta, of_zeta = (xi, eta, zeta) if is_tet else (1.0 - abs(xi), 1.0 - abs(eta), 1.0 - abs(zeta))
    least = min(of_xi / math.sqrt(a * a + b * b + c * c), of_eta / math.sqrt(d * d + f * f + g * g),
                of_zeta / math.sqrt(h * h + i * i + j * j))
    if is_tet:
        a, b, c = a + d + h, b + f + i, c + g + j
        least = min(least, (1.0 - xi - eta - zeta) / math.sqrt(a * a + b * b + c * c))
    return least


@numba.njit(cache=True)
def _find_cells_in_space(points, shapes, buckets, edge, cells):  # type: ignore[no-untyped-def]
    """The first cell that holds each point, or else the nearest one within the distance ``edge``."""
    columns, rows, planes = buckets.counts
    low = buckets.low
    for k in range(len(points)):
        x, y, z = points[k]
        column, row, plane = (x - low[0]) / buckets.size, (y - low[1]) / buckets.size, (z - low[2]) / buckets.size
        if not (0.0 <= column < columns and 0.0 <= row < rows and 0.0 <= plane < planes):
            continue
        bucket = (int(plane) * rows + int(row)) * columns + int(column)
        deepest = -edge
        for n in range(buckets.first[bucket], buckets.first[bucket + 1]):
            e = buckets.cells[n]
            begin, end = shapes.lowest[e], shapes.highest[e]
            if (x < begin[0] - edge or y < begin[1] - edge or z < begin[2] - edge
                    or x > end[0] + edge or y > end[1] + edge or z > end[2] + edge):
                continue
            depth = _measure_depth_in_space(shapes.geometry[e], points[k], shapes.is_tet[e])
            if depth >= deepest:
                cells[k] = e
                deepest = depth
            if depth >= 0.0:
                break


def is_inside_outline(points: Array, mesh: Mesh) -> BoolArray:
    """Tell whether points, pixels, lie in a mesh and not in its holes, by how often a ray to the right crosses it."""
    edges = mesh.nodes[find_boundary_facets(mesh)[:, :2]]
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    # Points outside the bounding box need no ray.
    inside = ((points >= low) & (points <= high)).all(axis=1)
    inside[inside] = is_inside_edges(points[inside], edges)
    return np.asarray(inside)


def find_cells_with_points(mesh: Mesh, points: Array, margin: float) -> IntArray:
    """Find the cells, convex and positive, sorted, that hold a point more than ``margin`` from their edges, pixels."""
    lowest, highest = mesh.whole_outlines.find_boxes()
    low, high = points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)
    near = ((lowest < high) & (highest > low)).all(axis=1)
    found = np.zeros(mesh.n_cells, dtype=bool)
    for cell in np.flatnonzero(near):
        in_box = ((points > lowest[cell]) & (points < highest[cell])).all(axis=1)
        corners = mesh.nodes[mesh.get_cell(cell)]
        along, apart = np.roll(corners, -1, axis=0) - corners, points[in_box][:, None] - corners
        # Of each point from the lines through the cell's edges, positive inside.
        distances = multiply_across(along, apart) / np.linalg.norm(along, axis=1)
        found[cell] = (distances > margin).all(axis=1).any()
    return np.flatnonzero(found).astype(np.int64)
