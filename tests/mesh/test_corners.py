"""Corners of cells with their neighbours."""

from __future__ import annotations

import numpy as np

from ddic.mesh.cell_type import Q4, T3
from ddic.mesh.mesh import build_mesh
from ddic.mesh.quality import list_corners

NODES = np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 8.0], [0.0, 8.0], [15.0, 4.0]])
MESH = build_mesh(NODES, [(Q4, np.array([[0, 1, 2, 3]])), (T3, np.array([[1, 4, 2], [4, 2, 1]]))])


def test_corners_know_the_nodes_beside_them() -> None:
    expected = []
    for number in range(MESH.n_cells):
        nodes = [node for node in MESH.cells[number].tolist() if node >= 0]
        expected += [(number, nodes[k], nodes[(k + 1) % len(nodes)], nodes[k - 1]) for k in range(len(nodes))]
    found = list_corners(MESH)
    assert list(zip(found.cells, found.nodes, *found.ends.T, strict=True)) == expected
