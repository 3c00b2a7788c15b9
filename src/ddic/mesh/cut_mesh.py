"""A mesh cut by discontinuities: each side of a cut cell is a cell of its own, with phantom nodes.

A node has a phantom for every side of its support, the cells around it, to which no path within these cells leads from
the node. Their shape functions span what the node's own and its products with shifted Heaviside functions do [RRH07];
ahead of a line's end the support hangs together, hence nothing opens there. Each part of a cut cell has a node itself,
or a phantom of it, which lies on the other side of a line; a point on its own side is found for each node.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np

from ddic.arrays import Array, IntArray
from ddic.mesh.cell_parts import CellParts, Lines, find_offsets
from ddic.mesh.mesh import Mesh
from ddic.mesh.plane import compute_normals, measure_distance, multiply_across
from ddic.mesh.topology import find_facets

INNER = -1
"""In place of a side or a node of the cell: an edge along a chord, a corner where a chord ends."""

SHORTEST_CHORD = 1e-9
"""Length, pixels, below which a chord in a polygon cuts nothing off."""

@dataclass(frozen=True, eq=False)
class _CellPolygon:
    """A convex polygon that is a cell, or a part of one; its corners, (n, 2), are in positive order, pixels.

    ``nodes`` are places in the cell of the nodes at the corners, ``sides`` those sides of the cell on which the edge
    from each corner to the next lies; INNER where there is no node, or the edge lies along a chord.
    """

    corners: Array
    nodes: tuple[int, ...]
    sides: tuple[int, ...]

    def cut(self, chord: Array) -> tuple[_CellPolygon, ...]:
        """Cut the polygon straight from end to end of a chord of its cell, whatever its bends.

        Gives the part to the right and the part to the left of the chord; the polygon itself where the chord misses it.
        """
        along = chord[-1] - chord[0]
        length = float(np.linalg.norm(along))
        if length <= SHORTEST_CHORD:
            # A line that turns back where it enters.
            return (self,)
        heights = multiply_across(along / length, self.corners - chord[0])
        if heights.max() <= SHORTEST_CHORD or heights.min() >= -SHORTEST_CHORD:
            return (self,)
        return self._keep(-heights), self._keep(heights)

    def _keep(self, heights: Array) -> _CellPolygon:
        """The part where heights, of the corners above a line, are positive."""
        corners, nodes, sides = [], [], []
        for k, here in enumerate(heights):
            following = (k + 1) % len(heights)
            there = heights[following]
            if here > 0:
                corners.append(self.corners[k])
                nodes.append(self.nodes[k])
                sides.append(self.sides[k])
            if (here > 0) != (there > 0):
                # In the same order from either side, hence the same number for both parts and for the next cell.
                low, high = sorted((k, following), key=lambda n: tuple(self.corners[n]))
                share = heights[low] / (heights[low] - heights[high])
                corners.append(self.corners[low] + share * (self.corners[high] - self.corners[low]))
                nodes.append(INNER)
                # Where the outline leaves the part, its next edge runs along the chord.
                sides.append(INNER if here > 0 else self.sides[k])
        return _CellPolygon(np.array(corners), tuple(nodes), tuple(sides))


def _find_chords(corners: Array, line: Array) -> list[Array]:
    """Find where a polyline crosses a convex cell from side to side; an end inside the cell cuts nothing.

    Gives the pieces of the line in the cell, (n, 2) each, one after the other: their ends lie on its outline. The
    cell's corners are in positive order, and no vertex of the line lies on its outline; both are pixels.
    """
    chords = []
    edges = np.roll(corners, -1, axis=0) - corners
    is_inside = bool((multiply_across(edges, line[0] - corners) > 0).all())
    # Empty until the line has entered the cell.
    piece: list[Array] = []
    for start, end in pairwise(line):
        for _, point in sorted(_cross_outline(corners, start, end), key=lambda crossing: crossing[0]):
            is_inside = not is_inside
            if is_inside:
                piece = [point]
            elif piece:
                chords.append(np.array([*piece, point]))
        if piece:
            piece.append(end)
    return chords


def _cross_outline(corners: Array, start: Array, end: Array) -> list[tuple[float, Array]]:
    """Where a segment crosses the cell's sides: share of its length, and the point."""
    crossings = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        # In the same order from either cell, so that both find the same point.
        low, high = sorted((a, b), key=tuple)
        of_low = float(multiply_across(end - start, low - start))
        of_high = float(multiply_across(end - start, high - start))
        if (of_low > 0) == (of_high > 0):
            continue
        point = low + of_low / (of_low - of_high) * (high - low)
        along = float((point - start) @ (end - start) / ((end - start) @ (end - start)))
        if 0 <= along < 1:
            crossings.append((along, point))
    return crossings


SHORTEST_TOUCH = 1e-9
"""Share of a side by which two parts must touch to hang together."""

Parts = Mapping[int, Sequence[_CellPolygon]]
"""Parts of the cut cells, by number of the cell."""

Unit = tuple[int, int]
"""A cell and the place of one of its parts; place 0 stands for the whole of a cell that is not cut."""

Member = tuple[int, Unit]
"""A node, and one of the units around it."""


def _number_nodes(mesh: Mesh, parts: Parts) -> dict[Member, int]:
    """Number the nodes of all parts, by node of the whole mesh and part; phantoms come after the mesh's nodes.

    Around a node, parts hang together that share a piece of a side, or the node itself. Those that hang together with
    the node have it, each other such group has a phantom.
    """
    cut_nodes = np.unique(np.concatenate([mesh.get_cell(cell) for cell in parts]))
    around = _find_cells_around(mesh, cut_nodes)
    groups = _group_units(mesh, parts, around)
    numbers: dict[Member, int] = {}
    next_phantom = mesh.n_nodes
    for node, cells in around.items():
        units = _list_units(cells, parts)
        of_group = {groups[node, unit]: node for unit in units if _holds_node(mesh, parts, unit, node)}
        for unit in units:
            group = groups[node, unit]
            if group not in of_group:
                of_group[group] = next_phantom
                next_phantom += 1
            numbers[node, unit] = of_group[group]
    return numbers


def _group_units(mesh: Mesh, parts: Parts, around: Mapping[int, Sequence[int]]) -> dict[Member, Member]:
    """Group the parts that hang together, around each of the nodes for itself: which member stands for each."""
    # Here, for it brings a tenth of a second of scipy's imports, and runs without discontinuities do without.
    from scipy.cluster.hierarchy import DisjointSet

    groups = DisjointSet((node, unit) for node, cells in around.items() for unit in _list_units(cells, parts))
    for node, cells in around.items():
        holding = [unit for unit in _list_units(cells, parts) if _holds_node(mesh, parts, unit, node)]
        for unit in holding:
            groups.merge((node, unit), (node, holding[0]))
    cells_around = np.unique(np.concatenate([np.asarray(cells, np.int64) for cells in around.values()]))
    for cell, neighbour, facet in _list_shared_facets(mesh, cells_around):
        for one, other in product(_list_units([cell], parts), _list_units([neighbour], parts)):
            reaches = [_find_reach(mesh, parts, unit, facet) for unit in (one, other)]
            touch = min(end for _, end in reaches) - max(start for start, _ in reaches) > SHORTEST_TOUCH
            for node in around.keys() & set(facet) if touch else ():
                groups.merge((node, one), (node, other))
    return {member: groups[member] for member in groups}


def _find_cells_around(mesh: Mesh, nodes: IntArray) -> dict[int, list[int]]:
    """Cells around each of some nodes."""
    cell_of_corner = np.repeat(np.arange(mesh.n_cells), np.diff(mesh.offsets))
    wanted = np.isin(mesh.connectivity, nodes)
    around: dict[int, list[int]] = {int(node): [] for node in nodes}
    for node, cell in zip(mesh.connectivity[wanted].tolist(), cell_of_corner[wanted].tolist(), strict=True):
        around[node].append(cell)
    return around


def _list_units(cells: Sequence[int], parts: Parts) -> list[Unit]:
    """All parts of some cells."""
    return [(cell, place) for cell in cells for place in range(len(parts[cell]) if cell in parts else 1)]


def _holds_node(mesh: Mesh, parts: Parts, unit: Unit, node: int) -> bool:
    """Whether a node of the cell lies in the part itself."""
    cell, place = unit
    if cell not in parts:
        return True
    in_cell = mesh.get_cell(cell).tolist().index(node)
    return in_cell in parts[cell][place].nodes


def _list_shared_facets(mesh: Mesh, cells: IntArray) -> list[tuple[int, int, tuple[int, int]]]:
    """Pairs of some cells that share a facet, and its nodes in ascending order."""
    part, nodes = mesh.create_submesh(cells)
    facets = find_facets(part)
    order = np.argsort(facets.side_facets, kind="stable")
    numbers, owners = facets.side_facets[order], facets.side_cells[order]
    found = []
    for k in np.flatnonzero(numbers[1:] == numbers[:-1]):
        one, other = sorted(nodes[facets.nodes[numbers[k]]].tolist())
        found.append((int(cells[owners[k]]), int(cells[owners[k + 1]]), (one, other)))
    return found


def _find_reach(mesh: Mesh, parts: Parts, unit: Unit, facet: tuple[int, int]) -> tuple[float, float]:
    """From where to where a part reaches along a facet, shares of its length from its lower node; empty if nowhere."""
    cell, place = unit
    if cell not in parts:
        return 0.0, 1.0
    nodes = mesh.get_cell(cell).tolist()
    side = next(k for k in range(len(nodes)) if {nodes[k], nodes[(k + 1) % len(nodes)]} == set(facet))
    polygon = parts[cell][place]
    if side not in polygon.sides:
        return 0.0, 0.0
    k = polygon.sides.index(side)
    ends = polygon.corners[[k, (k + 1) % len(polygon.corners)]]
    start, end = mesh.nodes[list(facet)]
    shares = (ends - start) @ (end - start) / ((end - start) @ (end - start))
    return float(shares.min()), float(shares.max())


CLEARANCE = 1e-3
"""Least distance, pixels, of a node from a line. A line that comes nearer is moved by about as much: it would else
belong to neither side of the node."""

MOST_MOVES = 100
"""Moves after which a line counts as one that cannot be kept clear of the nodes."""


@dataclass(frozen=True, eq=False)
class CutMesh:
    """A mesh with its cut cells.

    Attributes
    ----------
    mesh : Mesh
        Whole cells as before, each cut cell replaced by one of its parts, its other parts after all cells; phantom
        nodes after all nodes.
    node_of : (mesh.n_nodes,) array of int64
        Node of the whole mesh that each node is, or is a phantom of.
    cell_of : (mesh.n_cells,) array of int64
        Cell of the whole mesh that each cell is, or is a part of.
    """

    mesh: Mesh
    node_of: IntArray
    cell_of: IntArray

    @property
    def lines(self) -> tuple[Array, ...]:
        """The polylines that cut it, pixels; none where it has no part."""
        return () if self.mesh.parts is None else self.mesh.parts.lines.polylines

    def find_with_phantoms(self, nodes: IntArray) -> IntArray:
        """Find some nodes of the whole mesh, and their phantoms, in the cut one; sorted."""
        return np.flatnonzero(np.isin(self.node_of, nodes)).astype(np.int64)

    def find_cut_nodes(self) -> IntArray:
        """Find the nodes of cut cells: sorted numbers in the cut mesh."""
        parts = self.mesh.parts
        nodes = np.zeros(0, np.int64) if parts is None else np.unique(self.mesh.cells[parts.cells])
        return nodes[nodes >= 0]

    def find_cells_at_phantoms(self) -> IntArray:
        """Find the cells with a phantom node, or a node that has one: sorted numbers in the cut mesh."""
        return self.mesh.find_cells_around(np.bincount(self.node_of)[self.node_of] > 1)


def cut_mesh(mesh: Mesh, lines: Sequence[Array], other_nodes: Array | None = None) -> CutMesh:
    """Cut a mesh of convex plane cells by polylines, (n_vertices, 2), pixels.

    It stays the same where no line crosses a cell from side to side. Lines are also kept clear of ``other_nodes``,
    (n, 2), pixels: those of smaller cells that the same lines are to cut.
    """
    nodes = mesh.nodes if other_nodes is None else np.concatenate([mesh.nodes, other_nodes])
    clear = tuple(_keep_clear(line, nodes) for line in lines)
    parts, bends = _cut_cells(mesh, clear)
    if not parts:
        return CutMesh(mesh, np.arange(mesh.n_nodes), np.arange(mesh.n_cells))
    return _replace_cut_cells(mesh, parts, Lines(clear, bends))


def is_cut_by(mesh: Mesh, line: Array) -> bool:
    """Tell whether a line, (n_vertices, 2), pixels, crosses a convex plane cell of a mesh from side to side."""
    return bool(_cut_cells(mesh, (_keep_clear(line, mesh.nodes),))[0])


def _keep_clear(line: Array, nodes: Array) -> Array:
    """The line, moved as little as keeps it clear of all nodes."""
    direction = line[-1] - line[0]
    normal = compute_normals(direction) / max(float(np.linalg.norm(direction)), CLEARANCE)
    low, high = line.min(axis=0) - 1, line.max(axis=0) + 1
    near = nodes[((nodes >= low) & (nodes <= high)).all(axis=1)]
    for n_moves in range(MOST_MOVES):
        # To one side and to the other by turns.
        step = (n_moves + 1) // 2 * (1 if n_moves % 2 else -1)
        moved = np.asarray(line + 2 * CLEARANCE * step * normal)
        if not len(near) or measure_distance(near, moved).min() >= CLEARANCE:
            return moved
    return line


def _cut_cells(mesh: Mesh, lines: Sequence[Array]) -> tuple[dict[int, list[_CellPolygon]], tuple[Array, ...]]:
    """Parts of the cells that lines cross from side to side, by number of the cell, and what bends there cut off."""
    found: dict[int, list[_CellPolygon]] = {}
    bends: list[Array] = []
    for cell in _find_touched_cells(mesh, lines):
        corners = mesh.nodes[mesh.get_cell(int(cell))]
        numbers = tuple(range(len(corners)))
        parts: list[_CellPolygon] = [_CellPolygon(corners, numbers, numbers)]
        for line in lines:
            for chord in _find_chords(corners, line):
                parts = [piece for part in parts for piece in part.cut(chord)]
                if len(chord) > 2:
                    bends.append(chord)
        if len(parts) > 1:
            found[int(cell)] = parts
    return found, tuple(bends)


def _find_touched_cells(mesh: Mesh, lines: Sequence[Array]) -> IntArray:
    """Cells whose box a segment's box meets and that have corners on both sides of the segment."""
    corners = mesh.nodes[mesh.connectivity]
    low, high = mesh.whole_outlines.find_boxes()
    touched = np.zeros(mesh.n_cells, dtype=bool)
    for line in lines:
        for start, end in pairwise(line):
            meets = ((low <= np.maximum(start, end)) & (high >= np.minimum(start, end))).all(axis=1)
            heights = (corners - start) @ compute_normals(end - start)
            lowest = np.minimum.reduceat(heights, mesh.offsets[:-1])
            highest = np.maximum.reduceat(heights, mesh.offsets[:-1])
            touched |= meets & (lowest <= 0) & (highest >= 0)
    return np.flatnonzero(touched).astype(np.int64)


def _replace_cut_cells(mesh: Mesh, parts: Mapping[int, Sequence[_CellPolygon]], lines: Lines) -> CutMesh:
    """Put the first part of each cut cell in its place, and its other parts after all cells."""
    numbers = _number_nodes(mesh, parts)
    n_nodes = max(mesh.n_nodes, max(numbers.values()) + 1)
    node_of = np.arange(n_nodes)
    for (node, _), number in numbers.items():
        node_of[number] = node

    others: list[Unit] = [(cell, place) for cell in parts for place in range(1, len(parts[cell]))]
    units = [*((cell, 0) for cell in parts), *others]
    cell_of = np.array([*range(mesh.n_cells), *(cell for cell, _ in others)], np.int64)
    # Of each unit the number of its cell, which rise: cut cells are known in order.
    places = np.array([*parts, *range(mesh.n_cells, len(cell_of))], np.int64)

    cells = mesh.cells[cell_of]
    for unit, place in zip(units, places, strict=True):
        own = mesh.get_cell(unit[0]).tolist()
        cells[place, :len(own)] = [numbers[node, unit] for node in own]
    outlines = [parts[cell][place].corners for cell, place in units]
    corner_offsets = find_offsets(np.array([len(outline) for outline in outlines]))
    sets = {name: np.flatnonzero(np.isin(node_of, members)) for name, members in mesh.node_sets.items()}
    cut = replace(mesh, nodes=mesh.nodes[node_of], connectivity=cells[cells >= 0],
                  offsets=find_offsets(np.diff(mesh.offsets)[cell_of]), types=mesh.types[cell_of], node_sets=sets,
                  parts=CellParts(places, corner_offsets, np.concatenate(outlines), corner_offsets[:-1], lines))
    return CutMesh(cut, node_of, cell_of)


def find_points_on_own_side(mesh: Mesh) -> Array:
    """Find a point for each node at which a field on the node's side of all lines can be looked up.

    (n_nodes, 2), pixels: the node itself or, where none of its parts holds it, the middle of the nearest of them.
    """
    points = mesh.nodes.copy()
    if mesh.parts is None or not mesh.parts.n_parts:
        return points
    parts = mesh.parts
    least = np.full(mesh.n_nodes, np.inf)
    for number, cell in enumerate(parts.cells):
        corners = parts.corners[parts.offsets[number]:parts.offsets[number + 1]]
        for node in mesh.get_cell(cell):
            is_held = (corners == mesh.nodes[node]).all(axis=1).any()
            point = mesh.nodes[node] if is_held else corners.mean(axis=0)
            distance = float(np.linalg.norm(point - mesh.nodes[node]))
            if distance < least[node]:
                points[node], least[node] = point, distance
    return points
