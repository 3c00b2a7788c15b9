"""A mesh with its fields, as other libraries hold them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.mesh.mesh import Mesh

Fields = Mapping[str, NDArray[Any]]


def to_meshio(mesh: Mesh, point_data: Fields, cell_data: Fields) -> Any:
    """Make a meshio mesh, whose ``write`` knows some forty formats.

    Parameters
    ----------
    mesh : Mesh
        Pixels, y down.
    point_data, cell_data : dict
        Name -> (n_nodes, ...) and (n_cells, ...) arrays.

    Returns
    -------
    meshio.Mesh
        Points (n_nodes, 3) with z = 0; a block of cells for each cell type, so that cells and their data are sorted by
        type where the mesh mixes them.
    """
    import meshio

    blocks = mesh.cell_blocks
    return meshio.Mesh(
        _points_in_space(mesh),
        [(block.type.meshio_name, block.nodes) for block in blocks],
        point_data=dict(point_data),
        cell_data={name: [values[block.cells] for block in blocks] for name, values in cell_data.items()},
    )


def to_pyvista(mesh: Mesh, point_data: Fields, cell_data: Fields) -> Any:
    """Make a PyVista grid, to look at in a notebook.

    Parameters
    ----------
    mesh : Mesh
        Pixels, y down.
    point_data, cell_data : dict
        Name -> (n_nodes, ...) and (n_cells, ...) arrays.

    Returns
    -------
    pyvista.UnstructuredGrid
        Points (n_nodes, 3) with z = 0; cells in the mesh's order.

    Raises
    ------
    InputError
        Where PyVista is not installed.
    """
    try:
        import pyvista
    except ImportError as error:
        raise InputError("PyVista is not installed here: pip install pyvista") from error
    # VTK's list of cells: the number of a cell's nodes, then its nodes, cell after cell.
    counts = np.diff(mesh.offsets)
    cells = np.insert(mesh.connectivity, mesh.offsets[:-1], counts)
    grid = pyvista.UnstructuredGrid(cells, mesh.types, _points_in_space(mesh))
    for name, values in point_data.items():
        grid.point_data[name] = values
    for name, values in cell_data.items():
        grid.cell_data[name] = values
    return grid


def _points_in_space(mesh: Mesh) -> NDArray[np.float64]:
    """Nodes with the coordinates that the mesh does not have set to 0, (n_nodes, 3)."""
    return np.pad(mesh.nodes, ((0, 0), (0, 3 - mesh.dim)))
