"""The mesh: frozen arrays of nodes and cells, for any dimension and cell type."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

VTK_TRIANGLE = 5
VTK_QUAD = 9
NODES_PER_CELL = {VTK_TRIANGLE: 3, VTK_QUAD: 4}
CELL_NAMES = {VTK_TRIANGLE: "T3", VTK_QUAD: "Q4"}


@dataclass(frozen=True)
class Similarity:
    """Mapping from mesh units to pixels, x_px = scale R(angle) x_mesh + translation.

    scale: pixels per mesh unit; angle: radians, positive from +x to +y; translation: pixels.
    """

    scale: float = 1.0
    angle: float = 0.0
    translation: tuple[float, ...] = (0.0, 0.0)

    @property
    def rotation(self) -> NDArray[np.float64]:
        """Rotation matrix R, shape (2, 2)."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        return np.array([[c, -s], [s, c]])

    def to_pixels(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Map points of shape (n, 2) from mesh units to pixels."""
        return np.asarray(self.scale * points @ self.rotation.T + np.asarray(self.translation))

    def vector_to_mesh_units(self, vectors: NDArray[np.float64]) -> NDArray[np.float64]:
        """Map displacement vectors of shape (n, 2) from pixels to mesh units."""
        return vectors @ self.rotation / self.scale


@dataclass(frozen=True)
class Mesh:
    """Nodes and cells in pixel coordinates (x = column, y = row, pixel centres at integers).

    nodes: (n_nodes, dim) float64, pixels.
    connectivity: (sum of nodes per cell,) int64, the cells' nodes one after the other.
    offsets: (n_cells + 1,) int64, cell e owns connectivity[offsets[e]:offsets[e + 1]].
    types: (n_cells,) uint8, VTK cell types (5 = T3, 9 = Q4).
    node_sets: name -> sorted node numbers.
    mapping: from the mesh file's units to pixels.
    """

    nodes: NDArray[np.float64]
    connectivity: NDArray[np.int64]
    offsets: NDArray[np.int64]
    types: NDArray[np.uint8]
    node_sets: Mapping[str, NDArray[np.int64]] = field(default_factory=dict)
    mapping: Similarity = field(default_factory=Similarity)

    @property
    def dim(self) -> int:
        """Number of space dimensions."""
        return int(self.nodes.shape[1])

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.nodes)

    @property
    def n_cells(self) -> int:
        """Number of cells."""
        return len(self.types)

    @property
    def n_dofs(self) -> int:
        """Number of displacement unknowns, node-major: dof = dim * node + component."""
        return self.nodes.size

    @cached_property
    def cells(self) -> NDArray[np.int64]:
        """Nodes of each cell, shape (n_cells, widest cell), padded with -1."""
        counts = np.diff(self.offsets)
        width = int(counts.max(initial=0))
        padded = np.full((self.n_cells, width), -1, dtype=np.int64)
        padded[np.arange(width) < counts[:, None]] = self.connectivity
        return padded

    @cached_property
    def centroids(self) -> NDArray[np.float64]:
        """Mean of each cell's nodes, shape (n_cells, dim), pixels."""
        sums = np.add.reduceat(self.nodes[self.connectivity], self.offsets[:-1], axis=0)
        return np.asarray(sums / np.diff(self.offsets)[:, None])

    def submesh(self, cells: NDArray[np.int64]) -> tuple[Mesh, NDArray[np.int64]]:
        """Restrict to the given cells; returns the mesh and its nodes' numbers in this one (sorted)."""
        padded = self.cells[cells]
        used = padded >= 0
        node_ids, local = np.unique(padded[used], return_inverse=True)
        counts = used.sum(axis=1)
        offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        sets = {name: _restrict(node_ids, members) for name, members in self.node_sets.items()}
        mesh = Mesh(self.nodes[node_ids], local.reshape(-1).astype(np.int64), offsets,
                    self.types[cells], sets, self.mapping)
        return mesh, node_ids


def _restrict(node_ids: NDArray[np.int64], members: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.flatnonzero(np.isin(node_ids, members)).astype(np.int64)


def mesh_from_cells(nodes: NDArray[np.float64], blocks: Mapping[int, NDArray[np.int64]],
                    node_sets: Mapping[str, NDArray[np.int64]] | None = None,
                    mapping: Similarity | None = None) -> Mesh:
    """Build a mesh from arrays of cells by VTK type; nodes (n, dim) in pixels, blocks[type] (n_cells, k)."""
    flat = [np.asarray(block, dtype=np.int64) for block in blocks.values()]
    counts = np.concatenate([np.full(len(b), b.shape[1]) for b in flat]) if flat else np.zeros(0, int)
    types = np.concatenate([np.full(len(b), t) for t, b in blocks.items()]) if flat else np.zeros(0)
    return Mesh(
        np.ascontiguousarray(nodes, dtype=np.float64),
        np.concatenate([b.ravel() for b in flat]) if flat else np.zeros(0, np.int64),
        np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        types.astype(np.uint8),
        dict(node_sets or {}),
        mapping or Similarity(),
    )
