"""The mesh as a result shows it: parts of cut cells as triangles, so that a discontinuity opens."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.mesh.cell_type import T3
from ddic.mesh.interpolation import evaluate_shapes_at
from ddic.mesh.mesh import Mesh, pad_cells
from ddic.partition.subdomain import Subdomain


@dataclass(frozen=True, eq=False)
class DrawnMesh:
    """Cells and points of a subdomain as they are written.

    Attributes
    ----------
    mesh : Mesh
        Whole cells as they are, each part of a cut one as triangles about its first corner.
    node_ids : (mesh.n_nodes,) array of int64
        Numbers of its points over the whole region: those of nodes, then those of parts' corners.
    cells : (mesh.n_cells,) array of int64
        The subdomain's cell that each cell is, or is a part of.
    weights : (mesh.n_nodes, n_nodes) csr_matrix or None
        Values at the points from those at the subdomain's nodes; None where they are the same.
    """

    mesh: Mesh
    node_ids: NDArray[np.int64]
    cells: NDArray[np.int64]
    weights: sparse.csr_matrix | None = None

    def interpolate(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Interpolate nodal values at the points.

        Parameters
        ----------
        values : (n_nodes, k) array
            At the subdomain's nodes.

        Returns
        -------
        (mesh.n_nodes, k) array
            At the points.
        """
        return values if self.weights is None else np.asarray(self.weights @ values)


def draw_mesh(subdomain: Subdomain, n_nodes: int) -> DrawnMesh:
    """Draw a subdomain's mesh.

    Parameters
    ----------
    subdomain : Subdomain
        Perhaps with parts of cut cells.
    n_nodes : int
        Of the whole region's mesh, after which corners of parts are numbered.

    Returns
    -------
    DrawnMesh
        The mesh itself where no cell is cut.
    """
    mesh, parts = subdomain.mesh, subdomain.mesh.parts
    if parts is None or not parts.n_parts:
        return DrawnMesh(mesh, subdomain.node_ids, np.arange(mesh.n_cells))
    whole = np.setdiff1d(np.arange(mesh.n_cells), parts.cells)
    whole_mesh, kept = mesh.create_submesh(whole)
    n_corners = np.diff(parts.offsets)
    part_of_corner = np.repeat(np.arange(len(parts.cells)), n_corners)
    part_of_triangle = np.repeat(np.arange(len(parts.cells)), n_corners - 2)
    place = np.arange(len(part_of_triangle)) - np.searchsorted(part_of_triangle, part_of_triangle)
    apex = parts.offsets[part_of_triangle]
    triangles = np.stack([apex, apex + place + 1, apex + place + 2], axis=1) + len(kept)
    drawn = Mesh(
        np.concatenate([whole_mesh.nodes, parts.corners]),
        np.concatenate([whole_mesh.connectivity, triangles.ravel()]),
        np.concatenate([whole_mesh.offsets, whole_mesh.offsets[-1] + 3 * np.arange(1, len(triangles) + 1)]),
        np.concatenate([whole_mesh.types, np.full(len(triangles), T3.vtk, np.uint8)]),
        mapping=mesh.mapping)
    numbers = parts.first_numbers[part_of_corner] + np.arange(len(parts.corners)) - parts.offsets[part_of_corner]
    node_ids = np.concatenate([subdomain.node_ids[kept], n_nodes + numbers])
    cells = np.concatenate([whole, parts.cells[part_of_triangle]])
    at_nodes = sparse.csr_matrix((np.ones(len(kept)), (np.arange(len(kept)), kept)), (len(kept), mesh.n_nodes))
    weights = sparse.vstack([at_nodes, _weigh_corners(mesh, parts.cells[part_of_corner], parts.corners)])
    return DrawnMesh(drawn, node_ids, cells, weights.tocsr())


def _weigh_corners(mesh: Mesh, cells: NDArray[np.int64], corners: NDArray[np.float64]) -> sparse.csr_matrix:
    """Shape functions of each corner's cell there, (n_corners, n_nodes)."""
    shapes = evaluate_shapes_at(mesh, cells, corners)
    rows = np.repeat(np.arange(len(corners)), shapes.shape[1])
    columns = pad_cells(mesh)[cells].ravel()
    return sparse.csr_matrix((shapes.ravel(), (rows, columns)), (len(corners), mesh.n_nodes))
