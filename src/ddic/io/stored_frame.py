"""A frame of a series as its file holds it, and the same in the pieces of another frame of its mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddic.io import result_schema as schema
from ddic.io.result_reader import merge_pieces

GEOMETRY = ("NumberOfPoints", "NumberOfCells", "NumberOfConnectivityIds", "Points", "Connectivity", "Offsets", "Types")


@dataclass(frozen=True)
class StoredFrame:
    """Geometry and fields of a result file, in its pieces and with its axes.

    Attributes
    ----------
    geometry : dict of (n,) or (n, 3) array
        The datasets of ``GEOMETRY`` by name.
    point_data, cell_data : dict of (n,), (n, 3) or (n, 6) array
        Fields by name, a row a point or cell of the pieces.
    """

    geometry: Mapping[str, NDArray[Any]]
    point_data: Mapping[str, NDArray[Any]]
    cell_data: Mapping[str, NDArray[Any]]


def read_stored_frame(file: Any) -> StoredFrame:
    """Read the geometry and the fields of a result file as they are.

    Parameters
    ----------
    file : h5py.File
        Of a pair, open for reading.

    Returns
    -------
    StoredFrame
        In memory.
    """
    point_data, cell_data = ({name: values[...] for name, values in file[kind].items()}
                             for kind in (schema.POINT_DATA, schema.CELL_DATA))
    return StoredFrame({name: file[schema.VTKHDF][name][...] for name in GEOMETRY}, point_data, cell_data)


def has_same_geometry(frame: StoredFrame, other: StoredFrame) -> bool:
    """Tell whether two frames have the same pieces of the same mesh.

    Parameters
    ----------
    frame, other : StoredFrame
        To compare.

    Returns
    -------
    bool
        False where mesh or pieces differ.
    """
    return all(np.array_equal(frame.geometry[name], other.geometry[name]) for name in GEOMETRY)


def partition_like(frame: StoredFrame, other: StoredFrame) -> StoredFrame:
    """Bring a frame's fields into the pieces of another one, where both have the same mesh.

    VTK's reader (9.7) loses pieces where steps have different numbers of them (docs/result-file.md), and geometry that
    stays is written once.

    Parameters
    ----------
    frame : StoredFrame
        Whose fields are wanted.
    other : StoredFrame
        Whose pieces are wanted.

    Returns
    -------
    StoredFrame
        The same values at the same nodes and cells; the frame as it is where its mesh is another one.
    """
    if has_same_geometry(frame, other):
        return frame
    points = _find_rows(frame.point_data[schema.GLOBAL_NODE_ID], other.point_data[schema.GLOBAL_NODE_ID])
    cells = _find_rows(frame.cell_data[schema.GLOBAL_CELL_ID], other.cell_data[schema.GLOBAL_CELL_ID])
    if points is None or cells is None or not _has_same_mesh(frame, other):
        return frame
    return StoredFrame(other.geometry, {name: values[points] for name, values in frame.point_data.items()},
                       {name: values[cells] for name, values in frame.cell_data.items()})


def _find_rows(ids: NDArray[np.int64], wanted: NDArray[np.int64]) -> NDArray[np.intp] | None:
    """Where numbers stand first; None where they are not the same ones."""
    known, first = np.unique(ids, return_index=True)
    if not np.array_equal(known, np.unique(wanted)):
        return None
    rows: NDArray[np.intp] = first[np.searchsorted(known, wanted)]
    return rows


def _has_same_mesh(frame: StoredFrame, other: StoredFrame) -> bool:
    """Whether the pieces joined are the same nodes and cells, bit by bit."""
    one, two = (merge_pieces(each.geometry, each.geometry["Points"], each.point_data[schema.GLOBAL_NODE_ID],
                             each.cell_data[schema.GLOBAL_CELL_ID]).mesh for each in (frame, other))
    return all(np.array_equal(getattr(one, name), getattr(two, name))
               for name in ("nodes", "connectivity", "offsets", "types"))
