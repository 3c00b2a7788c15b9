"""Which node each part of a cut cell has: a node itself, or a phantom of it on the other side of a line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ddic.mesh.cut_cells import Polygon
from ddic.mesh.mesh import Mesh
from ddic.mesh.topology import find_facets

SHORTEST = 1e-9
"""Share of a side by which two parts must touch to hang together."""

Parts = Mapping[int, Sequence[Polygon]]
"""Parts of the cut cells, by number of the cell."""

Unit = tuple[int, int]
"""A cell and the place of one of its parts; place 0 stands for the whole of a cell that is not cut."""


def number_nodes(mesh: Mesh, parts: Parts) -> dict[tuple[int, Unit], int]:
    """Number the nodes of all parts; phantoms come after the mesh's nodes.

    Around a node, parts hang together that share a piece of a side, or the node itself. Those that hang together with
    the node have it, each other such group has a phantom.

    Parameters
    ----------
    mesh : Mesh
        The whole mesh.
    parts : mapping
        Of its cut cells.

    Returns
    -------
    dict
        Number by node of the mesh and part.
    """
    cut_nodes = np.unique(np.concatenate([get_nodes(mesh, cell) for cell in parts]))
    around = _find_cells_around(mesh, cut_nodes)
    groups = _group_units(mesh, parts, around)
    numbers: dict[tuple[int, Unit], int] = {}
    next_phantom = mesh.n_nodes
    for node, cells in around.items():
        units = _list_units(cells, parts)
        of_group = {groups.find((node, unit)): node for unit in units if _holds_node(mesh, parts, unit, node)}
        for unit in units:
            group = groups.find((node, unit))
            if group not in of_group:
                of_group[group] = next_phantom
                next_phantom += 1
            numbers[node, unit] = of_group[group]
    return numbers


def get_nodes(mesh: Mesh, cell: int) -> NDArray[np.int64]:
    """Give the nodes of a cell.

    Parameters
    ----------
    mesh : Mesh
        Any.
    cell : int
        Its number.

    Returns
    -------
    (n,) array of int64
        In the cell's order.
    """
    return mesh.connectivity[mesh.offsets[cell]:mesh.offsets[cell + 1]]


class _Groups:
    """Parts around nodes, (node, part), joined two by two."""

    def __init__(self) -> None:
        self._parent: dict[tuple[int, Unit], tuple[int, Unit]] = {}

    def find(self, member: tuple[int, Unit]) -> tuple[int, Unit]:
        """The one that stands for a member's group."""
        root = member
        while self._parent.setdefault(root, root) != root:
            root = self._parent[root]
        self._parent[member] = root
        return root

    def join(self, one: tuple[int, Unit], other: tuple[int, Unit]) -> None:
        """Make one group of those of two members."""
        self._parent[self.find(one)] = self.find(other)


def _group_units(mesh: Mesh, parts: Parts, around: Mapping[int, Sequence[int]]) -> _Groups:
    """Parts that hang together, around each of the nodes for itself."""
    groups = _Groups()
    for node, cells in around.items():
        holding = [unit for unit in _list_units(cells, parts) if _holds_node(mesh, parts, unit, node)]
        for unit in holding:
            groups.join((node, unit), (node, holding[0]))
    cells_around = np.unique(np.concatenate([np.asarray(cells, np.int64) for cells in around.values()]))
    for cell, neighbour, facet in _list_shared_facets(mesh, cells_around):
        for one in _list_units([cell], parts):
            for other in _list_units([neighbour], parts):
                if _touch(_find_reach(mesh, parts, one, facet), _find_reach(mesh, parts, other, facet)):
                    for node in facet:
                        groups.join((node, one), (node, other))
    return groups


def _find_cells_around(mesh: Mesh, nodes: NDArray[np.int64]) -> dict[int, list[int]]:
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
    in_cell = get_nodes(mesh, cell).tolist().index(node)
    return in_cell in parts[cell][place].nodes


def _list_shared_facets(mesh: Mesh, cells: NDArray[np.int64]) -> list[tuple[int, int, tuple[int, int]]]:
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
    nodes = get_nodes(mesh, cell).tolist()
    side = next(k for k in range(len(nodes)) if {nodes[k], nodes[(k + 1) % len(nodes)]} == set(facet))
    polygon = parts[cell][place]
    if side not in polygon.sides:
        return 0.0, 0.0
    k = polygon.sides.index(side)
    ends = polygon.corners[[k, (k + 1) % len(polygon.corners)]]
    start, end = mesh.nodes[list(facet)]
    shares = (ends - start) @ (end - start) / ((end - start) @ (end - start))
    return float(shares.min()), float(shares.max())


def _touch(one: tuple[float, float], other: tuple[float, float]) -> bool:
    return min(one[1], other[1]) - max(one[0], other[0]) > SHORTEST
