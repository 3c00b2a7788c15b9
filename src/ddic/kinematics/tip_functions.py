"""Crack tips: about the end of a line, displacements that hold the root of the distance from it [RRH07, Eq. 10].

The functions are no polynomials. Cells about a tip are cut into small ones, whose nodes move as the functions say:
nothing else knows of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from ddic.arrays import Array, IntArray
from ddic.kinematics.enriched import EnrichedRegion
from ddic.mesh.cell_type import CELL_TYPES, T3, CellType
from ddic.mesh.cut_mesh import CutMesh, cut_mesh, find_points_on_own_side
from ddic.mesh.interpolation import evaluate_shapes_at, locate
from ddic.mesh.mesh import Mesh, build_mesh, join_meshes, pad_cells
from ddic.mesh.plane import compute_normals
from ddic.mesh.quality import measure_cell_size

LONGEST = 2.0
"""Side of the small cells, pixels. A larger one interpolates the functions less well, a smaller one takes longer."""

N_FUNCTIONS = 4


@dataclass(frozen=True, eq=False)
class Tip:
    """An end of a line inside the mesh.

    Attributes
    ----------
    position : (2,) array
        Pixels.
    ahead : (2,) array
        Unit vector along which the line would go on.
    nodes : (n,) array of int64
        Nodes of the cell that it lies in.
    cells : (m,) array of int64
        Cells around these nodes.
    line, vertex : int
        Number of the line, and of its vertex, 0 or -1.
    """

    position: Array
    ahead: Array
    nodes: IntArray
    cells: IntArray
    line: int
    vertex: int


@dataclass(frozen=True, eq=False)
class TipPatch:
    """Tips, and small cells in place of those about them.

    Attributes
    ----------
    tips : tuple of Tip
        At least one.
    small : Mesh
        The small cells, not cut.
    cell_of : (small.n_cells,) array of int64
        The cell of the whole mesh that each lies in.
    """

    tips: tuple[Tip, ...]
    small: Mesh
    cell_of: IntArray


def find_tips(mesh: Mesh, lines: Sequence[Array], with_functions: Sequence[bool]) -> TipPatch | None:
    """Find the ends of lines that lie inside a mesh that is not cut; None where no such line ends in it.

    Lines are (n_vertices, 2), pixels; ``with_functions`` says whether the ends of each count.
    """
    tips = [tip for number, line in enumerate(lines) if with_functions[number]
            for tip in _find_ends_inside(mesh, line, number)]
    if not tips:
        return None
    around = np.unique(np.concatenate([tip.cells for tip in tips]))
    small, cell_of = subdivide_cells(mesh, around, LONGEST)
    return TipPatch(tuple(tips), small, cell_of)


def find_bends_at_tips(mesh: Mesh, line: Array) -> Array:
    """Find the vertices of a line at which it bends in the small cells about one of its ends, (n, 2), pixels.

    The line is (n_vertices, 2), pixels; the mesh is the whole one, not cut.
    """
    around = [tip.cells for tip in _find_ends_inside(mesh, line, 0)]
    cells = locate(mesh, line[1:-1]).cells
    return np.asarray(line[1:-1][np.isin(cells, np.concatenate([np.zeros(0, np.int64), *around]))])


def _find_ends_inside(mesh: Mesh, line: Array, number: int) -> list[Tip]:
    tips = []
    for vertex, before in ((0, line[1]), (-1, line[-2])):
        end = line[vertex]
        cell = int(locate(mesh, end[None]).cells[0])
        if cell < 0:
            continue
        nodes = mesh.get_cell(cell)
        cells = mesh.find_cells_around(np.isin(np.arange(mesh.n_nodes), nodes))
        ahead = (end - before) / np.linalg.norm(end - before)
        tips.append(Tip(end, ahead, nodes, cells, number, vertex))
    return tips


def evaluate_tip_functions(tip: Tip, points: Array, on_own_side: Array) -> Array:
    """Evaluate the four functions that span the singular displacements about a tip [RRH07, Eq. 10].

    Root of r times sin(theta/2), cos(theta/2), and both times sin(theta), (n, 4), px^(1/2), at points, (n, 2), pixels.
    ``on_own_side`` is a point near each, on the side of the line from which the functions go on to it.
    """
    r, theta = _find_polar(tip, points)
    _, theta_of_side = _find_polar(tip, on_own_side)
    # Beyond a face, theta goes on beyond pi.
    theta = theta + 2 * np.pi * np.rint((theta_of_side - theta) / (2 * np.pi))
    sine, cosine = np.sin(theta / 2), np.cos(theta / 2)
    return np.asarray(np.sqrt(r)[:, None] * np.stack([sine, cosine, sine * np.sin(theta), cosine * np.sin(theta)],
                                                     axis=1))


def _find_polar(tip: Tip, points: Array) -> tuple[Array, Array]:
    """Distance from the tip, and angle from the direction ahead."""
    x = (points - tip.position) @ tip.ahead
    y = (points - tip.position) @ compute_normals(tip.ahead)
    return np.hypot(x, y), np.arctan2(y, x)


def enrich_at_tips(cut: CutMesh, region: EnrichedRegion, patch: TipPatch) -> tuple[EnrichedRegion, IntArray]:
    """Give nodes about tips amplitudes of the tip functions, four for each component.

    ``cut`` is a mesh cut by lines that are clear of the small cells' nodes; the unknowns of ``region`` stay the first
    ones. The mesh of the region that comes back has all nodes of the old one, of which those about tips are in no cell,
    then those of the small cells. The second array is the cell of the whole mesh that each of its cells is, or lies in.
    """
    small = cut_mesh(patch.small, cut.lines)
    points, on_own_side = small.mesh.nodes, find_points_on_own_side(small.mesh)
    shapes = _evaluate_shapes_of_whole(cut.mesh, points, on_own_side)
    # Lines were moved off nodes, which would else lie on neither face.
    tips = [replace(tip, position=cut.lines[tip.line][tip.vertex]) for tip in patch.tips]
    of_tips = [_evaluate_products(cut.mesh, tip, shapes, points, on_own_side) for tip in tips]

    dim = cut.mesh.dim
    at_patch = sparse.hstack([sparse.kron(block, sparse.identity(dim)) for block in (shapes, *of_tips)]).tocsr()
    n_more = at_patch.shape[1] - cut.mesh.n_dofs
    unknowns_at_nodes = sparse.block_diag([region.matrix, sparse.identity(n_more)], format="csr")
    of_nodes = sparse.hstack([region.matrix, sparse.csr_matrix((cut.mesh.n_dofs, n_more))])
    matrix = sparse.vstack([of_nodes, at_patch @ unknowns_at_nodes]).tocsr()

    kept = np.flatnonzero(~np.isin(cut.cell_of, patch.cell_of)).astype(np.int64)
    nodes_of_tips = np.concatenate([np.repeat(tip.nodes, N_FUNCTIONS * dim) for tip in patch.tips])
    enriched = EnrichedRegion(join_meshes([cut.mesh.keep_cells(kept), small.mesh]), matrix,
                              np.concatenate([region.node_of_unknown, nodes_of_tips]),
                              np.concatenate([region.seen_at, nodes_of_tips]))
    return enriched, np.concatenate([cut.cell_of[kept], patch.cell_of[small.cell_of]])


def _evaluate_shapes_of_whole(mesh: Mesh, points: Array, on_own_side: Array) -> sparse.csr_matrix:
    """Shape functions of a cut mesh's nodes at points, each on its own side of all lines, (n_points, n_nodes)."""
    cells = locate(mesh, on_own_side).cells
    shapes = evaluate_shapes_at(mesh, cells, points)
    rows = np.repeat(np.arange(len(points)), shapes.shape[1])
    found = sparse.csr_matrix((shapes.ravel(), (rows, pad_cells(mesh)[cells].ravel())), (len(points), mesh.n_nodes))
    # Rounding at nodes and on sides would make unknowns of cells that have none there.
    found.data[np.abs(found.data) < 1e-12] = 0.0
    found.eliminate_zeros()
    return found


def _evaluate_products(mesh: Mesh, tip: Tip, shapes: sparse.csr_matrix, points: Array,
                       on_own_side: Array) -> sparse.csr_matrix:
    """N_a (F_j - F_j(x_a)) of a tip's nodes at points, (n_points, n_nodes * 4), of about 1 pixel a unit."""
    scale = 1 / np.sqrt(measure_cell_size(mesh))
    at_points = scale * evaluate_tip_functions(tip, points, on_own_side)
    products = []
    for node in tip.nodes:
        at_node = mesh.nodes[[node]]
        shifted = at_points - scale * evaluate_tip_functions(tip, at_node, at_node)
        products.append(shapes[:, [int(node)]].multiply(shifted))
    return sparse.hstack(products).tocsr()


def subdivide_cells(mesh: Mesh, cells: IntArray, longest: float) -> tuple[Mesh, IntArray]:
    """Cut whole T3 and Q4 cells into small ones; nodes on a side that two cells share are there twice.

    No side of a small cell is longer than ``longest`` pixels where cells are parallelograms. Gives the mesh of the
    small cells, and the cell that each of them lies in.
    """
    blocks: list[tuple[CellType, IntArray]] = []
    nodes: list[Array] = []
    cell_of: list[IntArray] = []
    n_nodes = 0
    for cell in cells:
        cell_type = CELL_TYPES[int(mesh.types[cell])]
        corners = mesh.nodes[mesh.get_cell(cell)]
        sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
        n = max(1, int(np.ceil(sides.max() / longest)))
        subdivide = _subdivide_triangle if cell_type is T3 else _subdivide_quadrilateral
        points, small = subdivide(corners, n)
        blocks.append((cell_type, small + n_nodes))
        nodes.append(points)
        cell_of.append(np.full(len(small), cell, dtype=np.int64))
        n_nodes += len(points)
    return build_mesh(np.concatenate(nodes), blocks), np.concatenate(cell_of)


def _subdivide_quadrilateral(corners: Array, n: int) -> tuple[Array, IntArray]:
    """Nodes ((n + 1)^2, 2) and cells (n^2, 4) of a grid in a quadrilateral, of n cells a side."""
    shares = np.arange(n + 1) / n
    below = _divide(corners[0], corners[1], shares)
    above = _divide(corners[3], corners[2], shares)
    rows = _divide(below, above, shares)
    numbers = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    cells = np.stack([numbers[:-1, :-1], numbers[:-1, 1:], numbers[1:, 1:], numbers[1:, :-1]], axis=-1)
    return rows.reshape(-1, 2), cells.reshape(-1, 4)


def _subdivide_triangle(corners: Array, n: int) -> tuple[Array, IntArray]:
    """Nodes and cells (n^2, 3) of a grid in a triangle, of n cells a side."""
    left = _divide(corners[0], corners[2], np.arange(n + 1) / n)
    right = _divide(corners[1], corners[2], np.arange(n + 1) / n)
    # One cell fewer in each row; the last is the triangle's third corner alone.
    n_of_rows = range(n, -1, -1)
    rows = [_divide(left[k], right[k], np.arange(n_of_row + 1) / max(n_of_row, 1))
            for k, n_of_row in enumerate(n_of_rows)]
    first = np.cumsum([0, *(len(row) for row in rows)])
    cells = []
    for k in range(n):
        here, beyond = first[k], first[k + 1]
        for i in range(n_of_rows[k]):
            cells.append([here + i, here + i + 1, beyond + i])
            if i + 1 < n_of_rows[k]:
                # Between two of those, the other way up.
                cells.append([here + i + 1, beyond + i + 1, beyond + i])
    return np.concatenate(rows), np.array(cells, dtype=np.int64)


def _divide(start: Array, end: Array, shares: Array) -> Array:
    """Points at shares of the way from start to end, one after the other: (n_shares, *start.shape).

    They lie exactly on a way along an axis and at its ends: a pixel there would else count twice, or not at all.
    """
    along = np.expand_dims(shares, tuple(range(1, start.ndim + 1)))
    return np.asarray(np.where(along == 1.0, end, start + along * (end - start)))
