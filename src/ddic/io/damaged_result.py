"""What tells that a result file is damaged: it cannot be read, or what it holds is not of one piece."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.io import result_schema as schema
from ddic.mesh.cell_type import CELL_TYPES
from ddic.mesh.mesh import Mesh
from ddic.mesh.quality import measure_shape_quality

if TYPE_CHECKING:
    from ddic.io.result_reader import Result

READ_ERRORS = (OSError, RuntimeError, KeyError, ValueError, IndexError, TypeError, AttributeError, ArithmeticError,
               MemoryError)
"""What HDF5, h5py and numpy raise on damaged files; h5py passes on most of HDF5's own as RuntimeError."""

LARGEST_PX = 1e7
"""Coordinate or displacement beyond which a number is damage: no image is as large."""

_ANY_COMPONENTS = (1, schema.VECTOR, schema.SYMMETRIC_TENSOR)
_COMPONENTS = {field.name: (field.n_components,) for field in schema.list_all_fields()} | {"Points": (schema.VECTOR,)}
"""Numbers that a row of a field may have, by name; of other fields any."""

MOST_DEFLATED = 1100
"""Bytes that a byte of a compressed dataset can stand for: deflate's limit is 1032."""


def describe_damage(error: BaseException) -> str:
    """Say in a line what could not be read.

    Parameters
    ----------
    error : exception
        One of READ_ERRORS.

    Returns
    -------
    str
        The first line of its message, or its kind where it has none.
    """
    message = str(error.args[0] if isinstance(error, KeyError) and error.args else error).strip()
    return message.splitlines()[0] if message else type(error).__name__


def read_array(dataset: Any) -> NDArray[Any]:
    """Read a dataset whole, unless it claims to hold more than its file can.

    Parameters
    ----------
    dataset : h5py.Dataset
        Of a file that may be damaged.

    Returns
    -------
    array
        Its values, of the dataset's shape.

    Raises
    ------
    ValueError
        Where memory would be filled with what is not there.
    """
    require_stored(dataset)
    return np.asarray(dataset[...])


def require_stored(dataset: Any) -> None:
    """Refuse a dataset that claims to hold more than its file can.

    Parameters
    ----------
    dataset : h5py.Dataset
        Of a file that may be damaged.

    Raises
    ------
    ValueError
        With both sizes.
    """
    if dataset.file.driver == "core":
        # Written by this program from what was read before.
        return
    stored = min(dataset.id.get_storage_size(), dataset.file.id.get_filesize())
    if dataset.nbytes > stored * (MOST_DEFLATED if dataset.compression else 1):
        raise ValueError(f"{dataset.name} claims {dataset.nbytes} bytes, of which {stored} are there")


def require_sound_pieces(grid: Mapping[str, NDArray[Any]], n_stored: int) -> None:
    """Refuse pieces of a mesh that do not fit together.

    Parameters
    ----------
    grid : dict of (n,) arrays
        NumberOfPoints, NumberOfCells, NumberOfConnectivityIds, Offsets, Connectivity and Types.
    n_stored : int
        Points of all pieces.

    Raises
    ------
    ValueError
        With what does not fit.
    """
    n_points, n_cells, n_ids = (grid[name] for name in ("NumberOfPoints", "NumberOfCells", "NumberOfConnectivityIds"))
    for name, values in grid.items():
        if values.ndim != 1 or values.dtype.kind not in "iu":
            raise ValueError(f"{name}: an array of {values.ndim} dimensions of {values.dtype}")
    if not len(n_points) == len(n_cells) == len(n_ids) or min(map(_least, (n_points, n_cells, n_ids))) < 0:
        raise ValueError("the numbers of points, cells and connectivities are not those of the same pieces")
    wanted = {"Points": (n_stored, n_points.sum()), "Types": (len(grid["Types"]), n_cells.sum()),
              "Offsets": (len(grid["Offsets"]), n_cells.sum() + len(n_cells)),
              "Connectivity": (len(grid["Connectivity"]), n_ids.sum())}
    for name, (found, expected) in wanted.items():
        if found != expected:
            raise ValueError(f"{name}: {found} rows, {expected} expected")
    if not n_cells.sum():
        raise ValueError("no cells")
    _require_sound_cells(grid)


def _require_sound_cells(grid: Mapping[str, NDArray[Any]]) -> None:
    """Refuse cells with other nodes than their types have, or than their piece has."""
    n_points, n_cells, n_ids = (grid[name] for name in ("NumberOfPoints", "NumberOfCells", "NumberOfConnectivityIds"))
    connectivity, types, offsets = grid["Connectivity"], grid["Types"], grid["Offsets"]
    unknown = set(np.unique(types).tolist()) - set(CELL_TYPES)
    if unknown:
        raise ValueError(f"Types: no cell is of type {min(unknown)}")
    if _least(connectivity) < 0 or (connectivity >= np.repeat(n_points, n_ids)).any():
        raise ValueError("Connectivity: cells have nodes that do not exist")
    n_nodes = np.zeros(1 + max(CELL_TYPES), np.int64)
    for number, cell_type in CELL_TYPES.items():
        n_nodes[number] = len(cell_type.nodes)
    ends = np.cumsum(n_cells + 1) - 1
    counts, first = np.delete(np.diff(offsets, append=0), ends), offsets[ends - n_cells]
    if (counts != n_nodes[types]).any() or first.any() or (offsets[ends] != n_ids).any():
        raise ValueError("Offsets: cells have other numbers of nodes than their types")


def require_sound_fields(fields: Mapping[str, NDArray[Any]], n_rows: int) -> None:
    """Refuse fields that are not numbers, or have not a row for each place.

    Parameters
    ----------
    fields : dict of (n_rows,), (n_rows, 3) or (n_rows, 6) arrays
        By name.
    n_rows : int
        Of each.

    Raises
    ------
    ValueError
        With the field.
    """
    for name, values in fields.items():
        counts = _COMPONENTS.get(name, _ANY_COMPONENTS)
        shapes = [(n_rows,) if count == 1 else (n_rows, count) for count in counts]
        if values.dtype.kind not in "iuf" or values.shape not in shapes:
            raise ValueError(f"{name}: an array of {values.dtype}, shape {values.shape}; {n_rows} rows of "
                             f"{' or '.join(map(str, counts))} numbers expected")


def require_sound_ids(point_data: Mapping[str, NDArray[Any]], cell_data: Mapping[str, NDArray[Any]]) -> None:
    """Refuse numbers of nodes, cells, subdomains and cameras that are none.

    Parameters
    ----------
    point_data, cell_data : dict of (n,), (n, 3) or (n, 6) arrays
        Fields of all pieces.

    Raises
    ------
    ValueError
        With what is wrong.
    """
    nodes, cells = point_data[schema.GLOBAL_NODE_ID], cell_data[schema.GLOBAL_CELL_ID]
    for name, numbers in ((schema.GLOBAL_NODE_ID, nodes), (schema.GLOBAL_CELL_ID, cells)):
        if numbers.ndim != 1 or numbers.dtype.kind not in "iu" or _least(numbers) < 0:
            raise ValueError(f"{name}: numbers from 0 on expected")
    for name in (schema.SUBDOMAIN_ID, schema.CAMERA):
        numbers = cell_data.get(name, cells)
        if numbers.dtype.kind not in "iu" or _least(numbers) < 0 or (name in cell_data and numbers.max() >= len(cells)):
            raise ValueError(f"{name}: numbers from 0 on expected, fewer than cells")


def require_sound_values(mesh: Mesh, displacement: NDArray[np.float64]) -> None:
    """Refuse places and displacements that no measurement has.

    Parameters
    ----------
    mesh : Mesh
        Pixels.
    displacement : (n_nodes, 2) array
        Pixels, nan where it was not measured.

    Raises
    ------
    ValueError
        With what is wrong.
    """
    if not (np.abs(mesh.nodes) <= LARGEST_PX).all():
        raise ValueError("Points: nodes lie in no image")
    if (np.abs(displacement) > LARGEST_PX).any():
        raise ValueError("displacement: larger than any image")
    n_shapeless = int((measure_shape_quality(mesh) <= 0.0).sum())
    if n_shapeless:
        raise ValueError(f"Points: {n_shapeless} cells are flat, crossed or not convex")


def require_known_displacement(result: Result) -> None:
    """Refuse a result to start from that lacks displacements where it measured them.

    Parameters
    ----------
    result : Result
        Of a pair or a frame.

    Raises
    ------
    InputError
        Where nothing was measured, or a node has no displacement although pixels of its cells count.
    """
    if not result.measured_nodes.any():
        raise InputError(f"{result.path}: holds no displacement of any node; start from another result")
    if json.loads(str(result.attributes.get(schema.CASE, {}).get("json", "{}"))).get("discontinuity"):
        # Where a line parts cells, pixels of a node's cells may say nothing of one of its sides.
        return
    n_cells = result.mesh.n_cells
    n_pixels = result.cell_data.get(schema.RESIDUAL_N_PIXELS, np.zeros(n_cells))
    counts = (n_pixels > 0) & (result.cell_data.get(schema.EXCLUDED, np.zeros(n_cells)) == 0)
    nodes = result.mesh.connectivity[np.repeat(counts, np.diff(result.mesh.offsets))]
    n_unknown = len(np.unique(nodes[~result.measured_nodes[nodes]]))
    if n_unknown:
        raise InputError(f"{result.path}: damaged: {n_unknown} nodes of cells that were measured have no displacement; "
                         "run ddic again")


def _least(values: NDArray[Any]) -> int:
    return int(values.min(initial=0))
