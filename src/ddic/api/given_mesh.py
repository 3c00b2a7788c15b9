"""Meshes given as ddic's, as meshio's, or as arrays."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.io.mesh_file import convert_mesh
from ddic.mesh.cell_type import CELL_TYPES
from ddic.mesh.mesh import Mesh, Similarity, build_mesh

if TYPE_CHECKING:
    import meshio

_EXPECTED = "give one of ddic.structured_mesh or meshio, or the arrays (nodes, cells)"


def convert_given_mesh(given: Mesh | meshio.Mesh | tuple[Any, Any], mapping: Similarity) -> Mesh:
    """Convert a mesh that the user gave.

    Parameters
    ----------
    given : Mesh, meshio.Mesh or tuple of arrays
        x = column, y = row; as a tuple the nodes (n_nodes, 2) and the cells (n_cells, 3 or 4).
    mapping : Similarity
        From its units to pixels.

    Returns
    -------
    Mesh
        Pixels; not yet repaired.

    Raises
    ------
    InputError
        Where it is no plane mesh of triangles and quadrilaterals.
    """
    if isinstance(given, Mesh):
        return _map(given, mapping)
    if isinstance(given, tuple):
        if len(given) != 2:
            raise InputError(f"mesh: a tuple of {len(given)}, two arrays expected; {_EXPECTED}")
        return _map(_from_arrays(*given), mapping)
    if _is_meshio_like(given):
        return convert_mesh(given, "mesh", mapping)
    raise InputError(f"mesh: {type(given).__name__} is no mesh; {_EXPECTED}")


def _map(mesh: Mesh, mapping: Similarity) -> Mesh:
    """Map the nodes, which stay to the last digit where there is nothing to do."""
    if mapping == Similarity():
        return mesh
    return replace(mesh, nodes=np.ascontiguousarray(mapping.to_pixels(mesh.nodes)), mapping=mapping)


def _is_meshio_like(given: Any) -> bool:
    """Whether it has points and blocks of cells; PyVista's cells are one array of numbers."""
    if not (hasattr(given, "points") and hasattr(given, "cells") and hasattr(given, "cell_sets")):
        return False
    return all(hasattr(block, "type") and hasattr(block, "data") for block in given.cells)


def _from_arrays(given_nodes: Any, given_cells: Any) -> Mesh:
    by_n_nodes = {kind.n_nodes: kind for kind in CELL_TYPES.values()}
    widths = " or ".join(str(n) for n in sorted(by_n_nodes))
    nodes, cells = _as_array(given_nodes, "nodes"), _as_array(given_cells, "cells")
    if nodes.ndim != 2 or nodes.shape[1] != 2 or nodes.dtype.kind not in "iuf":
        raise InputError(f"mesh: nodes of shape {nodes.shape} and type {nodes.dtype}, numbers of shape (n_nodes, 2) "
                         "expected: column and row of each, pixels")
    if cells.ndim != 2 or cells.shape[1] not in by_n_nodes or cells.dtype.kind not in "iu":
        raise InputError(f"mesh: cells of shape {cells.shape} and type {cells.dtype}, whole numbers of shape (n_cells, "
                         f"{widths}) expected: the nodes of each cell, numbered from 0")
    kind = by_n_nodes[cells.shape[1]]
    return build_mesh(nodes.astype(np.float64), [(kind, cells.astype(np.int64))])


def _as_array(given: Any, name: str) -> NDArray[Any]:
    try:
        return np.asarray(given)
    except ValueError as error:
        # Rows of different lengths.
        raise InputError(f"mesh: {name} in rows of different lengths; give a mesh of triangles and quadrilaterals "
                         "together as one of meshio") from error
