"""A mixed, irregular T3/Q4 mesh of a beam with a hole."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np

from ddic.mesh.cell_type import Q4, T3
from ddic.mesh.structured import build_structured_mesh
from ddic.mesh.topology import find_boundary_nodes


def write_beam_mesh(path: Path, region: tuple[float, float, float, float], element_size: float,
                    hole: tuple[tuple[float, float], float], seed: int = 0) -> None:
    """Write a mesh whose inner nodes are moved at random and of whose quadrangles two in five are cut in two."""
    mesh = build_structured_mesh(region, element_size, "Q4", [hole], [], None)
    rng = np.random.default_rng(seed)
    moved = rng.uniform(-0.18, 0.18, size=mesh.nodes.shape) * element_size
    moved[find_boundary_nodes(mesh)] = 0.0
    quads = mesh.cells[mesh.types == Q4.vtk]
    triangles = mesh.cells[mesh.types == T3.vtk][:, :3]
    cut = rng.random(len(quads)) < 0.4
    halves = np.concatenate([quads[cut][:, [0, 1, 2]], quads[cut][:, [0, 2, 3]]])
    cells = [("quad", quads[~cut]), ("triangle", np.concatenate([triangles, halves]))]
    points = np.pad(mesh.nodes + moved, ((0, 0), (0, 1)))
    meshio.write(path, meshio.Mesh(points, cells), file_format="vtk")
