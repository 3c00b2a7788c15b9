"""Facets of a mesh: which cells share them, which lie on the boundary."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.mesh import VTK_QUAD, VTK_TRIANGLE, Mesh
from ddic.mesh.node_selection import named_nodes

# Nodes of each facet of a cell, in the cell's own order; a 3-D cell type is one more entry.
LOCAL_FACETS: dict[int, tuple[tuple[int, ...], ...]] = {
    VTK_TRIANGLE: ((0, 1), (1, 2), (2, 0)),
    VTK_QUAD: ((0, 1), (1, 2), (2, 3), (3, 0)),
}


@dataclass(frozen=True)
class Facets:
    """Facets of a mesh (edges in 2-D), each once, and the cell sides that lie on them.

    nodes: (n_facets, widest facet) int64, in the order of the first cell, padded with -1.
    side_facets: (n_sides,) int64, the facet of each side of each cell.
    side_cells: (n_sides,) int64, the cell of each side.
    """

    nodes: NDArray[np.int64]
    side_facets: NDArray[np.int64]
    side_cells: NDArray[np.int64]

    @cached_property
    def n_cells(self) -> NDArray[np.int64]:
        """Number of cells on each facet, shape (n_facets,)."""
        return np.bincount(self.side_facets, minlength=len(self.nodes)).astype(np.int64)


def facets(mesh: Mesh) -> Facets:
    """Find the facets of all cells; facets with the same nodes are one."""
    sides, cells = _sides(mesh)
    # A facet is its set of nodes, whatever the order in which a cell runs through them.
    first, numbers = _distinct_rows(np.sort(sides, axis=1), mesh.n_nodes)
    return Facets(sides[first], numbers, cells)


def boundary_facets(mesh: Mesh) -> NDArray[np.int64]:
    """Nodes of the facets that belong to exactly one cell, shape (n, widest facet), padded with -1."""
    found = facets(mesh)
    return np.asarray(found.nodes[found.n_cells == 1])


def boundary_nodes(mesh: Mesh) -> NDArray[np.int64]:
    """Sorted numbers of the nodes on facets that belong to exactly one cell."""
    nodes = np.unique(boundary_facets(mesh))
    return nodes[nodes >= 0]


def named_facets(mesh: Mesh, name: str) -> NDArray[np.int64]:
    """Boundary facets whose nodes all belong to the node set ``name``, shape (n, widest facet).

    Raises InputError where the mesh has no node set of that name.
    """
    outer = boundary_facets(mesh)
    members = np.isin(outer, named_nodes(mesh, name)) | (outer < 0)
    return np.asarray(outer[members.all(axis=1)])


def cell_adjacency(mesh: Mesh) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Graph of the cells that share a facet, as compressed rows (indptr, indices), sorted, without loops.

    indptr: (n_cells + 1,); indices: the neighbours of cell e are indices[indptr[e]:indptr[e + 1]].
    """
    found = facets(mesh)
    order = np.argsort(found.side_facets, kind="stable")
    cells, numbers = found.side_cells[order], found.side_facets[order]
    one, other = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    # Sides of one facet follow each other: two in a proper mesh, more where cells overlap or branch.
    for step in range(1, int(found.n_cells.max(initial=0))):
        same = numbers[step:] == numbers[:-step]
        one += [cells[step:][same], cells[:-step][same]]
        other += [cells[:-step][same], cells[step:][same]]
    keys = np.unique(np.concatenate(one) * mesh.n_cells + np.concatenate(other))
    rows, columns = np.divmod(keys, max(mesh.n_cells, 1))
    indptr = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=mesh.n_cells))])
    return indptr.astype(np.int64), columns.astype(np.int64)


def _sides(mesh: Mesh) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Nodes of every side of every cell, padded with -1, and the cell of each."""
    kinds = np.unique(mesh.types)
    width = max((len(side) for kind in kinds for side in LOCAL_FACETS[int(kind)]), default=0)
    sides, cells = [np.zeros((0, width), np.int64)], [np.zeros(0, np.int64)]
    for kind in kinds:
        members = np.flatnonzero(mesh.types == kind).astype(np.int64)
        for local in LOCAL_FACETS[int(kind)]:
            block = np.full((len(members), width), -1, dtype=np.int64)
            block[:, :len(local)] = mesh.cells[members][:, local]
            sides.append(block)
            cells.append(members)
    return np.concatenate(sides), np.concatenate(cells)


def _distinct_rows(rows: NDArray[np.int64], n_nodes: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Number the distinct rows: (first row of each, number of each row).

    One-dimensional keys sort many times faster than numpy.unique(axis=0).
    """
    first = np.zeros(0, np.int64)
    keys = rows[:, 0] + 1 if rows.size else np.zeros(0, np.int64)  # + 1 because of the padding
    for column in rows.T[1:]:
        # Numbered afresh at each column, so that keys stay below n_rows * n_nodes.
        _, first, numbers = np.unique(keys * (n_nodes + 1) + column + 1,
                                      return_index=True, return_inverse=True)
        keys = numbers.reshape(-1).astype(np.int64)
    return first.astype(np.int64), keys
