"""Split the cells of a mesh, or of a grid, into subdomains, and join those that cannot stand alone with a neighbour."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
import pymetis
from scipy import sparse
from scipy.sparse import csgraph

from ddic.arrays import Array, BoolArray, IntArray
from ddic.errors import InputError
from ddic.mesh.grid import GridBlock, GridLines
from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import rasterize
from ddic.mesh.topology import find_adjacent_cells
from ddic.partition.subdomain import MotionUnknowns, Subdomain

MEAN_WEIGHT = 1000.0
"""Mean of the whole numbers that METIS gets for weights; a larger value rounds them less."""

LARGEST_SUM = 2.0**30
"""Largest sum of these numbers, which METIS adds up in 32 bits with a sign."""

N_CUTS, N_PASSES = 8, 50
"""METIS's tries, of which the best is kept, and passes of refinement: ragged interfaces cost Krylov iterations in every
step. Larger values take longer."""

MOST_BISECTED = 8
"""Most subdomains that are found by repeated halving, as METIS's manual advises for few parts; more are cut at once."""


def split_by_metis(mesh: Mesh, n_subdomains: int, weights: Array | None = None) -> IntArray:
    """Split by METIS on the graph of cells that share a facet; what it leaves empty gets a cell of the largest part.

    Gives the subdomain of each cell. ``weights``, of any scale, are balanced, by default the number of cells. Raises
    InputError where there are fewer cells than subdomains.
    """
    if n_subdomains == 1:
        return np.zeros(mesh.n_cells, dtype=np.int64)
    if n_subdomains > mesh.n_cells:
        raise InputError(f"mesh: {mesh.n_cells} cells for {n_subdomains} subdomains, one a rank at least; start fewer "
                         "ranks, use smaller elements, or ask for fewer subdomains (solver.subdomains)")
    indptr, indices = find_adjacent_cells(mesh)
    _, parts = pymetis.part_graph(
        n_subdomains,
        adjacency=pymetis.CSRAdjacency(indptr, indices),
        recursive=n_subdomains <= MOST_BISECTED,
        options=pymetis.Options(seed=1, ncuts=N_CUTS, niter=N_PASSES),
        vweights=None if weights is None else _whole_weights(weights).tolist(),
    )
    return _fill_empty(np.asarray(parts, dtype=np.int64), n_subdomains, (indptr, indices))


def split_by_blocks(mesh: Mesh, blocks: tuple[int, ...]) -> IntArray:
    """Split into a regular array of blocks of the bounding box, by the cells' centroids.

    Gives the subdomain of each cell. ``blocks`` are counted along each axis; those that hold no cell are dropped.
    """
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    place = np.floor((mesh.centroids - low) / (high - low) * np.asarray(blocks)).astype(np.int64)
    # The first axis varies fastest.
    return renumber(np.ravel_multi_index(tuple(place.T), blocks, mode="clip", order="F"))


def split_grid(grid: GridLines, n_subdomains: int) -> list[GridBlock]:
    """Split into boxes of about as many cells, at most one for each cell, by halving along the longest side."""
    return _halve(GridBlock(tuple(map(range, grid.n_along))), n_subdomains)


def _halve(block: GridBlock, n: int) -> list[GridBlock]:
    """Boxes of a block, n of them."""
    if n == 1:
        return [block]
    ranges = block.ranges
    axis = max(range(len(ranges)), key=lambda k: len(ranges[k]))
    along, n_across = ranges[axis], block.n_cells // len(ranges[axis])
    half = n // 2
    middle = min(max(round(len(along) * half / n), 1), len(along) - 1)
    # Where there are few cells, each of the boxes on either side needs one.
    half = min(max(half, n - (len(along) - middle) * n_across), middle * n_across)
    low, high = (GridBlock((*ranges[:axis], part, *ranges[axis + 1:])) for part in (along[:middle], along[middle:]))
    return [*_halve(low, half), *_halve(high, n - half)]


def split_grid_by_blocks(grid: GridLines, blocks: tuple[int, ...]) -> list[GridBlock]:
    """Split into columns and rows of blocks, as ``split_by_blocks`` splits a mesh of the grid."""
    ranges = [_split_line(line, n) for line, n in zip(grid.lines, blocks, strict=True)]
    # The first axis varies fastest.
    return [GridBlock(of_axes[::-1]) for of_axes in product(*ranges[::-1])]


def _split_line(line: Array, n: int) -> list[range]:
    """Ranges of cells along a line whose middles lie in each of n equal parts of it, where there are any."""
    middles = (line[1:] + line[:-1]) / 2
    place = np.minimum(np.floor((middles - line[0]) / (line[-1] - line[0]) * n), n - 1)
    _, first, counts = np.unique(place, return_index=True, return_counts=True)
    return [range(int(begin), int(begin + count)) for begin, count in zip(first, counts, strict=True)]


def renumber(parts: IntArray) -> IntArray:
    """Number the subdomains of the cells, (n_cells,), 0, 1, ... without gaps, in the old order."""
    _, places = np.unique(parts, return_inverse=True)
    return np.asarray(places, dtype=np.int64).reshape(-1)


def _fill_empty(parts: IntArray, n_subdomains: int, adjacent: tuple[IntArray, IntArray]) -> IntArray:
    """Give subdomains that METIS leaves empty that cell of the largest one with fewest neighbours there."""
    indptr, indices = adjacent
    filled, counts = parts.copy(), np.bincount(parts, minlength=n_subdomains)
    for empty in np.flatnonzero(counts == 0):
        largest = int(counts.argmax())
        cells = np.flatnonzero(filled == largest)
        n_beside = [int((filled[indices[indptr[cell]:indptr[cell + 1]]] == largest).sum()) for cell in cells]
        filled[cells[int(np.argmin(n_beside))]] = empty
        counts[largest] -= 1
        counts[empty] = 1
    return filled


def _whole_weights(weights: Array) -> IntArray:
    """Weights as whole numbers of at least 1: METIS knows no others."""
    unit = max(float(np.mean(weights)) / MEAN_WEIGHT, float(np.sum(weights)) / LARGEST_SUM)
    if unit <= 0:
        return np.ones(len(weights), np.int64)
    return np.asarray(np.maximum(np.rint(weights / unit), 1), dtype=np.int64)


NODE_PIXELS = 1000.0
"""Work of a node (two unknowns: factors, interface set-up, linear steps) in units of a pixel's (gradient, M,
residuals, the image that is written): bench/cell_costs.py. A larger value balances nodes rather than pixels."""


def estimate_cell_costs(mesh: Mesh) -> Array:
    """Estimate the work that each cell brings: its pixels', and its share of its nodes', in units of a pixel's.

    Nodes at the edge are taken for inner ones, so that equal cells have equal weights and METIS cuts a regular mesh
    regularly.
    """
    own_nodes = np.empty(mesh.n_cells)
    for block in mesh.cell_blocks:
        own_nodes[block.cells] = block.type.n_nodes / block.type.cells_around_node
    return np.asarray(rasterize(mesh).pixel_counts + NODE_PIXELS * own_nodes)


Adjacency = tuple[IntArray, IntArray]
"""Cells that share a facet, as compressed rows (indptr, indices): ``find_adjacent_cells``."""


def find_connected_pieces(adjacency: Adjacency) -> IntArray:
    """Find the piece of each cell, from 0: facets connect cells, a node alone, which is a hinge, does not."""
    indptr, indices = adjacency
    n_cells = len(indptr) - 1
    ones = np.ones(len(indices), dtype=np.int64)
    graph = sparse.csr_matrix((ones, indices, indptr), shape=(n_cells, n_cells))
    _, pieces = csgraph.connected_components(graph, directed=False)
    return np.asarray(pieces, dtype=np.int64)


def join_pairs(one: IntArray, other: IntArray, n: int) -> IntArray:
    """Join n things by pairs of them: the group of each, (n,), from 0 in the order of their first members."""
    graph = sparse.coo_matrix((np.ones(len(one)), (one, other)), (n, n))
    return np.asarray(csgraph.connected_components(graph, directed=False)[1], dtype=np.int64)


def merge_blank(pieces: IntArray, owner: IntArray, adjacency: Adjacency, blank: BoolArray) -> IntArray:
    """Join every connected group of blank pieces with the textured one that shares most facets with it.

    A group without a textured neighbour (a piece of the mesh by itself) stays as it is. Of neighbours with equally many
    facets the lowest is taken. Load is no criterion: pixels without texture cost a residual pass but no iteration, and
    a part of the mesh that nothing holds but its neighbour must be with it, however large it is.

    ``pieces`` is the connected piece of each cell, ``owner`` the subdomain of each piece, ``blank`` true for pieces
    that cannot stand alone. Gives the new subdomain of each cell, from 0 without gaps, in the old order.
    """
    n_pieces = len(blank)
    n_shared = _count_shared_facets(pieces, adjacency, n_pieces)
    blank_pieces = np.flatnonzero(blank)
    among_blank = n_shared[blank_pieces][:, blank_pieces]
    n_groups, group_of = csgraph.connected_components(among_blank, directed=False)

    # The piece whose subdomain each piece will be part of.
    host = np.arange(n_pieces)
    for group in range(n_groups):
        members = blank_pieces[group_of == group]
        with_others = np.asarray(n_shared[members].sum(axis=0)).ravel()
        with_textured = np.where(blank, 0, with_others)
        if with_textured.any():
            host[members] = int(with_textured.argmax())

    owner_of_piece = owner[host]
    return renumber(owner_of_piece[pieces])


def _count_shared_facets(pieces: IntArray, adjacency: Adjacency, n_pieces: int) -> sparse.csr_matrix:
    """Number of facets that each two different pieces share, (n_pieces, n_pieces)."""
    indptr, indices = adjacency
    # Each pair of adjacent cells: the piece of one, the piece of the other.
    one = np.repeat(pieces, np.diff(indptr))
    other = pieces[indices]
    is_apart = one != other
    pairs = (one[is_apart], other[is_apart])
    ones = np.ones(len(pairs[0]), dtype=np.int64)
    # Entries of one place add up.
    return sparse.csr_matrix((ones, pairs), shape=(n_pieces, n_pieces))


SplitInto = Callable[[IntArray, int], IntArray]
"""From the cells of a camera and a number of subdomains to the subdomain of each of these cells."""


def assign_cameras(mesh: Mesh, seen: Sequence[BoolArray]) -> IntArray:
    """Assign each cell to the first near camera that sees all its nodes, else to the first of all cameras.

    ``seen`` says for each near camera whether it sees each node of the whole mesh, (n_nodes,). Cameras count from 0.
    """
    labels = np.zeros(mesh.n_cells, dtype=np.int64)
    # The first near camera comes last, so that what it sees is its own.
    for place in reversed(range(len(seen))):
        is_corner_seen = seen[place][mesh.connectivity]
        is_cell_seen = np.logical_and.reduceat(is_corner_seen, mesh.offsets[:-1])
        labels[is_cell_seen] = place + 1
    return labels


def find_cameras_at_nodes(mesh: Mesh, labels: IntArray, n_cameras: int,
                          weights: sparse.csr_matrix | None = None) -> BoolArray:
    """Find the cameras that measure a cell at each node, (n_nodes, n_cameras), from the camera of each cell.

    ``weights``, (n_nodes, n_unknown_nodes), are for where some nodes are tied to others: then the cells of a node are
    also those of the nodes that are tied to it, and only unknown nodes have a row, (n_unknown_nodes, n_cameras).
    """
    camera_of_corner = np.repeat(labels, np.diff(mesh.offsets))
    present = np.zeros((mesh.n_nodes, n_cameras), dtype=bool)
    present[mesh.connectivity, camera_of_corner] = True
    if weights is None:
        return present
    is_tied_to = weights != 0
    n_tied = is_tied_to.T @ present.astype(np.int64)
    return np.asarray(n_tied > 0)


def split_by_camera(labels: IntArray, costs: Array, n_subdomains: int, split: SplitInto) -> IntArray:
    """Split each camera's cells by themselves, into subdomains of about equal cost; the first camera's come first.

    Gives the subdomain of each cell, from its camera and its work; ``n_subdomains`` are all of them, and ``split``
    divides the cells of one camera. Raises InputError where cameras outnumber subdomains.
    """
    cameras = np.unique(labels)
    if n_subdomains < len(cameras):
        raise InputError(f"solver.subdomains = {n_subdomains}: {len(cameras)} cameras measure elements, and each needs "
                         f"a subdomain of its own; ask for at least {len(cameras)}")
    cells_of = [np.flatnonzero(labels == camera) for camera in cameras]
    work = np.array([costs[cells].sum() for cells in cells_of])
    counts = _apportion(work, n_subdomains, [len(cells) for cells in cells_of])
    parts = np.zeros(len(labels), dtype=np.int64)
    first = 0
    for cells, count in zip(cells_of, counts, strict=True):
        parts[cells] = first + split(cells, count)
        first += count
    return parts


def keep_cameras_apart(parts: IntArray, labels: IntArray) -> IntArray:
    """Cut subdomains where cells' cameras change: the new subdomain of each cell, numbered by camera without gaps."""
    n_parts = int(parts.max()) + 1
    by_camera_and_part = labels * n_parts + parts
    return renumber(by_camera_and_part)


def add_motions(subdomains: Sequence[Subdomain], cameras: Sequence[int], n_motion_unknowns: Sequence[int],
                n_field: int, n_chain_rows: int) -> list[Subdomain]:
    """Give subdomains the unknowns of their cameras' motions, numbered after those of the field.

    The last of all subdomains owns the interface rows of all motions, which follow those of all chains. By number of
    subdomain and of camera, ``cameras`` are those of all subdomains and ``n_motion_unknowns`` their motions' unknowns;
    ``n_field`` are those of the whole field.
    """
    # Unknowns of all motions, camera after camera; each has a row of its own after those of the chains.
    first = np.concatenate([[0], np.cumsum(n_motion_unknowns)]).astype(np.int64)
    with_motion = []
    for subdomain in subdomains:
        camera = subdomain.camera
        of_camera = np.arange(first[camera], first[camera + 1])
        motion = None
        if len(of_camera):
            is_lowest = cameras.index(camera) == subdomain.index
            motion = MotionUnknowns(n_field + of_camera, n_chain_rows + of_camera, cameras.count(camera), is_lowest)
        n_motion_rows = int(first[-1]) if subdomain.index == len(cameras) - 1 else 0
        with_motion.append(replace(subdomain, motion=motion, n_owned_rows=subdomain.n_owned_rows + n_motion_rows))
    return with_motion


def _apportion(work: Array, total: int, most: Sequence[int]) -> list[int]:
    """Whole numbers from 1 to ``most`` that add up to ``total``, so that the largest work a piece is least."""
    limits = np.asarray(most)
    counts = np.ones(len(work), dtype=np.int64)
    for _ in range(total - len(work)):
        # One piece more where pieces are largest; -1 where there can be no more.
        loads = np.where(counts < limits, work / counts, -1.0)
        counts[loads.argmax()] += 1
    return [int(count) for count in counts]
