"""Meshes of half the size: each plane cell in four, with nodes in the middle of its sides and perhaps in its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ddic.arrays import Array, IntArray
from ddic.mesh.mesh import Mesh, build_mesh

HALVED: Mapping[int, tuple[tuple[int, ...], ...]] = {
    5: ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)),
    9: ((0, 4, 8, 7), (4, 1, 5, 8), (8, 5, 2, 6), (7, 8, 6, 3))}
"""Cells that a cell is split into, by VTK's numbers: its corners, the middles of its sides, its own middle."""


@dataclass(frozen=True, eq=False)
class RefinedMesh:
    """A mesh of half the size.

    Attributes
    ----------
    mesh : Mesh
        Its first nodes are those of the coarse one, its cells follow each other as those do. Node sets have the middles
        of sides between two of their nodes, too.
    parents : (mesh.n_cells,) array of int64
        Cell of the coarse mesh that each is a part of.
    weights : (mesh.n_nodes, n_coarse_nodes) csr_matrix
        From values at the coarse nodes to those of the same field at the fine ones.
    """

    mesh: Mesh
    parents: IntArray
    weights: sparse.csr_matrix

    def interpolate(self, values: Array) -> Array:
        """Take a field at the coarse nodes, (n_coarse_nodes * dim,), to the fine ones, (mesh.n_nodes * dim,)."""
        return np.asarray(self.weights @ values.reshape(self.weights.shape[1], -1)).ravel()


def refine(mesh: Mesh) -> RefinedMesh:
    """Halve the cells of a plane mesh that nothing cuts."""
    sides = [np.sort(block.nodes[:, block.type.facets], axis=-1).reshape(-1, 2) for block in mesh.cell_blocks]
    edges, places = np.unique(np.concatenate(sides), axis=0, return_inverse=True)
    # The nodes of which each new one is in the middle.
    middles_of = [np.arange(mesh.n_nodes)[:, None], edges]
    n_nodes, first, blocks, parents = mesh.n_nodes + len(edges), 0, [], []
    for block in mesh.cell_blocks:
        n_sides = len(block.type.facets)
        middles = mesh.n_nodes + places.ravel()[first:first + n_sides * len(block.cells)].reshape(-1, n_sides)
        first += middles.size
        numbers = [block.nodes, middles]
        if block.type.n_nodes == 4:
            middles_of.append(block.nodes)
            numbers.append(n_nodes + np.arange(len(block.cells))[:, None])
            n_nodes += len(block.cells)
        parts = np.concatenate(numbers, axis=1)[:, HALVED[block.type.vtk]]
        blocks.append((block.type, parts.reshape(-1, block.type.n_nodes)))
        parents.append(np.repeat(block.cells, parts.shape[1]))
    weights = sparse.vstack([_average(nodes, mesh.n_nodes) for nodes in middles_of]).tocsr()
    order = np.argsort(np.concatenate(parents), kind="stable")
    fine = build_mesh(weights @ mesh.nodes, blocks, _refine_sets(mesh, edges), mesh.mapping)
    return RefinedMesh(fine.keep_cells(order), np.concatenate(parents)[order], weights)


def _average(nodes: IntArray, n_nodes: int) -> sparse.csr_matrix:
    """Means over the nodes of each row, as factors of values at all nodes, (n, n_nodes)."""
    n, n_in_row = nodes.shape
    rows = np.repeat(np.arange(n), n_in_row)
    return sparse.csr_matrix((np.full(nodes.size, 1.0 / n_in_row), (rows, nodes.ravel())), (n, n_nodes))


def _refine_sets(mesh: Mesh, edges: IntArray) -> dict[str, IntArray]:
    """Node sets with the middles of edges, (n_edges, 2), between two of their nodes."""
    sets = {}
    for name, members in mesh.node_sets.items():
        is_member = np.zeros(mesh.n_nodes, dtype=bool)
        is_member[members] = True
        sets[name] = np.concatenate([members, mesh.n_nodes + np.flatnonzero(is_member[edges].all(axis=1))])
    return sets
