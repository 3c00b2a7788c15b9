"""Meshes given as ddic's, as meshio's, or as arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.io.mesh_file import convert_mesh
from ddic.mesh.cell_type import CELL_TYPES
from ddic.mesh.mesh import Mesh, Similarity, build_mesh

if TYPE_CHECKING:
    import meshio

MeshLike = "Mesh | meshio.Mesh | tuple[NDArray[np.float64], NDArray[np.int64]]"
"""A mesh in pixels: ddic's, meshio's, or nodes (n_nodes, 2) and cells (n_cells, 3 or 4)."""


def convert_given_mesh(given: Mesh | meshio.Mesh | tuple[Any, Any]) -> Mesh:
    """Convert a mesh that the user gave.

    Parameters
    ----------
    given : Mesh, meshio.Mesh or tuple of arrays
        Pixels, x = column, y = row; as a tuple the nodes (n_nodes, 2) and the cells (n_cells, 3 or 4).

    Returns
    -------
    Mesh
        Not yet repaired.

    Raises
    ------
    InputError
        Where it is no plane mesh of triangles and quadrilaterals.
    """
    if isinstance(given, Mesh):
        return given
    if isinstance(given, tuple):
        return _from_arrays(*(np.asarray(part) for part in given))
    if hasattr(given, "points") and hasattr(given, "cells"):
        return convert_mesh(given, "mesh", Similarity())
    raise InputError(f"mesh: {type(given).__name__} is no mesh; give one of ddic or meshio, or (nodes, cells)")


def _from_arrays(nodes: NDArray[Any], cells: NDArray[Any]) -> Mesh:
    by_n_nodes = {kind.n_nodes: kind for kind in CELL_TYPES.values()}
    if nodes.ndim != 2 or nodes.shape[1] != 2:
        raise InputError(f"mesh: nodes of shape {nodes.shape}, (n_nodes, 2) expected: column and row of each, pixels")
    if cells.ndim != 2 or cells.shape[1] not in by_n_nodes or not np.issubdtype(cells.dtype, np.integer):
        widths = " or ".join(str(n) for n in sorted(by_n_nodes))
        raise InputError(f"mesh: cells of shape {cells.shape} and type {cells.dtype}, whole numbers of shape (n_cells, "
                         f"{widths}) expected: the nodes of each cell, numbered from 0")
    kind = by_n_nodes[cells.shape[1]]
    return build_mesh(nodes.astype(np.float64), [(kind, cells.astype(np.int64))])
