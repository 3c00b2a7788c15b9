"""A mesh cut by discontinuities: each side of a cut cell is a cell of its own, with phantom nodes.

A node has a phantom for every side of its support, the cells around it, to which no path within these cells leads from
the node. Their shape functions span what the node's own and its products with shifted Heaviside functions do [RRH07];
ahead of a line's end the support hangs together, hence nothing opens there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.cell_parts import CellParts, Lines
from ddic.mesh.cut_cells import Polygon, find_chords
from ddic.mesh.mesh import Mesh
from ddic.mesh.phantom_nodes import Parts, Unit, get_nodes, number_nodes
from ddic.mesh.polyline import measure_distance

CLEARANCE = 1e-3
"""Least distance, pixels, of a node from a line. A line that comes nearer is moved by about as much: it would else
belong to neither side of the node."""

MOST_MOVES = 100
"""Moves after which a line counts as one that cannot be kept clear of the nodes."""

Array = NDArray[np.float64]


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
    node_of: NDArray[np.int64]
    cell_of: NDArray[np.int64]

    @property
    def lines(self) -> tuple[Array, ...]:
        """The polylines that cut it, pixels; none where it has no part."""
        return () if self.mesh.parts is None else self.mesh.parts.lines.polylines

    def find_with_phantoms(self, nodes: NDArray[np.int64]) -> NDArray[np.int64]:
        """Find some nodes of the whole mesh, and their phantoms, in the cut one.

        Parameters
        ----------
        nodes : (n,) array of int64
            Numbers in the whole mesh.

        Returns
        -------
        (m,) array of int64
            Sorted numbers in the cut mesh.
        """
        return np.flatnonzero(np.isin(self.node_of, nodes)).astype(np.int64)

    def find_cut_nodes(self) -> NDArray[np.int64]:
        """Find the nodes of cut cells.

        Returns
        -------
        (n,) array of int64
            Sorted numbers in the cut mesh.
        """
        parts = self.mesh.parts
        nodes = np.zeros(0, np.int64) if parts is None else np.unique(self.mesh.cells[parts.cells])
        return nodes[nodes >= 0]

    def find_cells_at_phantoms(self) -> NDArray[np.int64]:
        """Find the cells with a phantom node, or a node that has one.

        Returns
        -------
        (n,) array of int64
            Sorted numbers in the cut mesh.
        """
        has_twin = np.bincount(self.node_of)[self.node_of] > 1
        of_corners = has_twin[self.mesh.connectivity]
        return np.flatnonzero(np.logical_or.reduceat(of_corners, self.mesh.offsets[:-1])).astype(np.int64)


def cut_mesh(mesh: Mesh, lines: Sequence[Array], other_nodes: Array | None = None) -> CutMesh:
    """Cut a mesh by polylines.

    Parameters
    ----------
    mesh : Mesh
        Of convex plane cells.
    lines : sequence of (n_vertices, 2) array
        Polylines, pixels.
    other_nodes : (n, 2) array, optional
        Nodes of smaller cells that the same lines are to cut, pixels: lines are kept clear of them too.

    Returns
    -------
    CutMesh
        The same mesh where no line crosses a cell from side to side.
    """
    nodes = mesh.nodes if other_nodes is None else np.concatenate([mesh.nodes, other_nodes])
    clear = tuple(_keep_clear(line, nodes) for line in lines)
    parts, bends = _cut_cells(mesh, clear)
    if not parts:
        return CutMesh(mesh, np.arange(mesh.n_nodes), np.arange(mesh.n_cells))
    return _replace_cut_cells(mesh, parts, Lines(clear, bends))


def is_cut_by(mesh: Mesh, line: Array) -> bool:
    """Tell whether a line crosses a cell of a mesh from side to side.

    Parameters
    ----------
    mesh : Mesh
        Of convex plane cells.
    line : (n_vertices, 2) array
        Polyline, pixels.

    Returns
    -------
    bool
        Whether it does.
    """
    return bool(_cut_cells(mesh, (_keep_clear(line, mesh.nodes),))[0])


def _keep_clear(line: Array, nodes: Array) -> Array:
    """The line, moved as little as keeps it clear of all nodes."""
    direction = line[-1] - line[0]
    normal = np.array([-direction[1], direction[0]]) / max(float(np.linalg.norm(direction)), CLEARANCE)
    low, high = line.min(axis=0) - 1, line.max(axis=0) + 1
    near = nodes[((nodes >= low) & (nodes <= high)).all(axis=1)]
    for n_moves in range(MOST_MOVES):
        # To one side and to the other by turns.
        step = (n_moves + 1) // 2 * (1 if n_moves % 2 else -1)
        moved = np.asarray(line + 2 * CLEARANCE * step * normal)
        if not len(near) or measure_distance(near, moved).min() >= CLEARANCE:
            return moved
    return line


def _cut_cells(mesh: Mesh, lines: Sequence[Array]) -> tuple[dict[int, list[Polygon]], tuple[Array, ...]]:
    """Parts of the cells that lines cross from side to side, by number of the cell, and what bends there cut off."""
    found: dict[int, list[Polygon]] = {}
    bends: list[Array] = []
    for cell in _find_touched_cells(mesh, lines):
        corners = mesh.nodes[get_nodes(mesh, int(cell))]
        parts: list[Polygon] = [Polygon.of_cell(corners)]
        for line in lines:
            for chord in find_chords(corners, line):
                parts = [piece for part in parts for piece in part.cut(chord)]
                if len(chord.bends):
                    bends.append(np.vstack([chord.start, chord.bends, chord.end]))
        if len(parts) > 1:
            found[int(cell)] = parts
    return found, tuple(bends)


def _find_touched_cells(mesh: Mesh, lines: Sequence[Array]) -> NDArray[np.int64]:
    """Cells whose box a segment's box meets and that have corners on both sides of the segment."""
    corners = mesh.nodes[mesh.connectivity]
    low = np.minimum.reduceat(corners, mesh.offsets[:-1], axis=0)
    high = np.maximum.reduceat(corners, mesh.offsets[:-1], axis=0)
    touched = np.zeros(mesh.n_cells, dtype=bool)
    for line in lines:
        for start, end in pairwise(line):
            meets = ((low <= np.maximum(start, end)) & (high >= np.minimum(start, end))).all(axis=1)
            normal = np.array([start[1] - end[1], end[0] - start[0]])
            heights = (corners - start) @ normal
            lowest = np.minimum.reduceat(heights, mesh.offsets[:-1])
            highest = np.maximum.reduceat(heights, mesh.offsets[:-1])
            touched |= meets & (lowest <= 0) & (highest >= 0)
    return np.flatnonzero(touched).astype(np.int64)


def _replace_cut_cells(mesh: Mesh, parts: Mapping[int, Sequence[Polygon]], lines: Lines) -> CutMesh:
    """Put the first part of each cut cell in its place, and its other parts after all cells."""
    numbers = number_nodes(mesh, parts)
    n_nodes = max(mesh.n_nodes, max(numbers.values()) + 1)
    node_of = np.arange(n_nodes)
    for (node, _), number in numbers.items():
        node_of[number] = node

    first: list[Unit] = [(cell, 0) for cell in parts]
    others: list[Unit] = [(cell, place) for cell in parts for place in range(1, len(parts[cell]))]
    cell_of = np.concatenate([np.arange(mesh.n_cells), np.array([cell for cell, _ in others], np.int64)])
    place_of_unit = dict(zip(first, parts, strict=True))
    place_of_unit |= dict(zip(others, range(mesh.n_cells, len(cell_of)), strict=True))

    cells = mesh.cells[cell_of]
    for unit, place in place_of_unit.items():
        own = get_nodes(mesh, unit[0]).tolist()
        cells[place, :len(own)] = [numbers[node, unit] for node in own]
    counts = np.diff(mesh.offsets)[cell_of]
    sets = {name: np.flatnonzero(np.isin(node_of, members)) for name, members in mesh.node_sets.items()}
    cut = replace(mesh, nodes=mesh.nodes[node_of], connectivity=cells[cells >= 0],
                  offsets=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64), types=mesh.types[cell_of],
                  node_sets=sets, parts=_outline_parts(parts, place_of_unit, lines))
    return CutMesh(cut, node_of, cell_of)


def _outline_parts(parts: Parts, place_of_unit: Mapping[Unit, int], lines: Lines) -> CellParts:
    """Outlines of all parts in the order of their places in the mesh."""
    units = sorted(place_of_unit, key=lambda unit: place_of_unit[unit])
    outlines = [parts[cell][place].corners for cell, place in units]
    offsets = np.concatenate([[0], np.cumsum([len(outline) for outline in outlines])]).astype(np.int64)
    places = np.array([place_of_unit[unit] for unit in units], np.int64)
    corners = np.concatenate([np.zeros((0, 2)), *outlines])
    return CellParts(places, offsets, corners, offsets[:-1], lines)
