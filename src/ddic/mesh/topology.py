"""Facets of a mesh and the cells that share them; nodes by name or box, and those whose equilibrium is not imposed."""

from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property

import numpy as np

from ddic.arrays import Array, BoolArray, IntArray
from ddic.errors import InputError
from ddic.mesh.cell_parts import find_offsets
from ddic.mesh.mesh import Mesh

SLACK = 1e-6
"""Share by which the normal of a facet of left or right may point more up or down than sideways: rounding."""


@dataclass(frozen=True)
class Facets:
    """Facets of a mesh (edges in 2-D), each once, and the cell sides that lie on them.

    Attributes
    ----------
    nodes : (n_facets, widest facet) int64 array
        In the order of the facet's first cell, padded with -1.
    side_facets, side_cells : (n_sides,) int64 array
        The facet and the cell of each side of each cell.
    run_backwards : (n_sides,) bool array
        Which sides run through their facet's nodes the other way round.
    """

    nodes: IntArray
    side_facets: IntArray
    side_cells: IntArray
    run_backwards: BoolArray

    @cached_property
    def n_cells(self) -> IntArray:
        """Number of cells on each facet, (n_facets,)."""
        return np.bincount(self.side_facets, minlength=len(self.nodes)).astype(np.int64)


def find_facets(mesh: Mesh) -> Facets:
    """Find the facets of all cells; facets with the same nodes are one."""
    sides, cells = _sides(mesh)
    # A facet is its set of nodes, whatever the order in which a cell runs through them.
    first, numbers = find_distinct_rows(np.sort(sides, axis=1), mesh.n_nodes)
    return Facets(sides[first], numbers, cells, sides[:, 0] != sides[first[numbers], 0])


def find_boundary_facets(mesh: Mesh) -> IntArray:
    """Find the facets that belong to exactly one cell: their nodes in the cell's order, padded with -1."""
    found = find_facets(mesh)
    return np.asarray(found.nodes[found.n_cells == 1])


def find_boundary_nodes(mesh: Mesh) -> IntArray:
    """Find the nodes on facets that belong to exactly one cell, sorted."""
    nodes = np.unique(find_boundary_facets(mesh))
    return nodes[nodes >= 0]


def find_boundary_sets(nodes: Array, facets: IntArray, holes: Sequence[IntArray]) -> dict[str, IntArray]:
    """Name the nodes of a plane mesh's boundary facets, (n, 2), which run as their cells do, positively.

    A facet is in the set hole_k of the first of ``holes`` that holds both of its nodes, else in left, right, top or
    bottom, by the quadrant that its outward normal points to; y points down. Sets are sorted, none is empty.
    """
    is_outer = np.ones(len(facets), dtype=bool)
    of_holes = {}
    for number, members in enumerate(holes):
        is_here = is_outer & np.isin(facets, members).all(axis=1)
        of_holes[f"hole_{number}"] = is_here
        is_outer &= ~is_here
    along = nodes[facets[:, 1]] - nodes[facets[:, 0]]
    # The normal is (dy, -dx). Rounding does not decide where it points between two quadrants.
    is_upright = np.abs(along[:, 1]) >= np.abs(along[:, 0]) * (1 - SLACK)
    named = {"left": is_outer & is_upright & (along[:, 1] < 0), "right": is_outer & is_upright & (along[:, 1] > 0),
             "top": is_outer & ~is_upright & (along[:, 0] > 0), "bottom": is_outer & ~is_upright & (along[:, 0] < 0),
             **of_holes}
    return {name: np.unique(facets[is_here]) for name, is_here in named.items() if is_here.any()}


def find_adjacent_cells(mesh: Mesh) -> tuple[IntArray, IntArray]:
    """Find the graph of the cells that share a facet, as compressed sorted rows without loops.

    Gives indptr and indices: the neighbours of cell e are indices[indptr[e]:indptr[e + 1]].
    """
    found = find_facets(mesh)
    order = np.argsort(found.side_facets, kind="stable")
    cells, numbers = found.side_cells[order], found.side_facets[order]
    one, other = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    # Sides of one facet follow each other: two in a proper mesh, more where cells overlap or branch.
    for step in range(1, int(found.n_cells.max(initial=0))):
        same = numbers[step:] == numbers[:-step]
        later, earlier = cells[step:][same], cells[:-step][same]
        one += [later, earlier]
        other += [earlier, later]
    # Each pair as one number, so that one sort finds the distinct pairs, row by row.
    pairs = np.unique(np.concatenate(one) * mesh.n_cells + np.concatenate(other))
    rows, columns = np.divmod(pairs, max(mesh.n_cells, 1))
    n_neighbours = np.bincount(rows, minlength=mesh.n_cells)
    return find_offsets(n_neighbours), columns.astype(np.int64)


def _sides(mesh: Mesh) -> tuple[IntArray, IntArray]:
    """Nodes of every side of every cell, padded with -1, and the cell of each."""
    width = max((len(facet) for block in mesh.cell_blocks for facet in block.type.facets), default=0)
    sides, cells = [np.zeros((0, width), np.int64)], [np.zeros(0, np.int64)]
    for block in mesh.cell_blocks:
        for facet in block.type.facets:
            padded = np.full((len(block.cells), width), -1, dtype=np.int64)
            padded[:, :len(facet)] = block.nodes[:, facet]
            sides.append(padded)
            cells.append(block.cells)
    return np.concatenate(sides), np.concatenate(cells)


def find_distinct_rows(rows: IntArray, n_nodes: int) -> tuple[IntArray, IntArray]:
    """Find and number the distinct rows of nodes, padded with -1: the first row of each, and the number of each row.

    One-dimensional keys sort many times faster than numpy.unique(axis=0).
    """
    first = np.zeros(0, np.int64)
    if rows.size == 0:
        return first, np.zeros(0, np.int64)
    # + 1 because of the padding, which is -1.
    keys = rows[:, 0] + 1
    for column in rows.T[1:]:
        # Numbered afresh at each column, so that keys stay below n_rows * n_nodes.
        longer = keys * (n_nodes + 1) + column + 1
        order = _sort(longer)
        is_first = np.diff(longer[order], prepend=-1) > 0
        first = order[is_first]
        keys = np.empty_like(longer)
        keys[order] = np.cumsum(is_first) - 1
    return first, keys


def _sort(keys: IntArray) -> IntArray:
    """Order of numbers from 0 on, of equal ones the first first: by 16 bits at a time, which numpy counts."""
    order = np.argsort(keys.astype(np.uint16), kind="stable")
    for shift in range(16, int(keys.max()).bit_length(), 16):
        order = order[np.argsort((keys[order] >> shift).astype(np.uint16), kind="stable")]
    return order.astype(np.int64)


def find_named_nodes(mesh: Mesh, name: str) -> IntArray:
    """Look up a node set: sorted nodes; raises InputError where it is empty or unknown, then with the nearest name."""
    sets = {key: nodes for key, nodes in sorted(mesh.node_sets.items()) if len(nodes)}
    if name in sets:
        return sets[name]
    is_empty = name in mesh.node_sets
    problem = f'the node set "{name}" holds no node of the mesh' if is_empty else f'no node set is named "{name}"'
    near = get_close_matches(name, sets, n=1)
    hint = f'did you mean "{near[0]}"? The' if near else "the"
    known = ", ".join(f'"{key}"' for key in sets) or "none"
    raise InputError(f"{problem}; {hint} mesh has: {known}")


def _find_nodes_in_box(mesh: Mesh, box: Sequence[float]) -> IntArray:
    """Nodes in a closed box, lowest corner, then highest, pixels; sorted. Raises InputError where there is none."""
    within = is_in_box(mesh.nodes, box)
    if not within.any():
        raise InputError(f"the box {list(box)} (x0, y0, x1, y1 in pixels) holds no node of the mesh")
    return np.flatnonzero(within).astype(np.int64)


def is_in_box(points: Array, box: Sequence[float]) -> BoolArray:
    """Tell which points, (n, dim), lie in a closed box, its lowest corner, then its highest, pixels."""
    dim = points.shape[1]
    return np.asarray(((points >= np.array(box[:dim])) & (points <= np.array(box[dim:]))).all(axis=1))


BOUNDARY = "boundary"
"""Stands for all nodes of the mesh's boundary, whatever the mesh's own node sets are."""


def find_not_controlled_nodes(mesh: Mesh, names: Sequence[str], boxes: Sequence[Sequence[float]],
                         boundary: IntArray | None = None) -> IntArray:
    """Find the nodes that are not mechanically controlled, by node sets or "boundary", and by boxes; sorted.

    Boxes are (x0, y0, x1, y1), pixels. ``boundary`` are the nodes of the boundary, by default those on facets of one
    cell. Raises InputError with a line for each unknown name, empty set and box without nodes.
    """
    chosen, problems = [np.zeros(0, np.int64)], []
    for name in names:
        try:
            if name == BOUNDARY:
                chosen.append(find_boundary_nodes(mesh) if boundary is None else boundary)
            else:
                chosen.append(find_named_nodes(mesh, name))
        except InputError as error:
            problems += [f"regularization.not_controlled: {line}; other nodes are chosen by regularization.boxes"
                         for line in error.problems]
    for box in boxes:
        try:
            chosen.append(_find_nodes_in_box(mesh, box))
        except InputError as error:
            problems += [f"regularization.boxes: {line}" for line in error.problems]
    if problems:
        raise InputError(problems)
    return np.unique(np.concatenate(chosen))
