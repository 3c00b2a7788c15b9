"""One result file of many: the frames of a series as steps of a VTKHDF file, which ParaView plays.

A frame of a series as its file holds it, and the same in the pieces of another frame of its mesh.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ddic.io import result_schema as schema
from ddic.io.damaged_result import open_hdf5
from ddic.io.hdf5_stream import new_hdf5
from ddic.io.replace_on_exit import NewFiles
from ddic.io.result_reader import merge_pieces
from ddic.io.series_folder import SeriesFolder
from ddic.io.sidecars import write_physical_sidecar

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
    """Read the geometry and the fields of the open result file of a pair as they are."""
    point_data, cell_data = ({name: values[...] for name, values in file[kind].items()}
                             for kind in (schema.POINT_DATA, schema.CELL_DATA))
    return StoredFrame({name: file[schema.VTKHDF][name][...] for name in GEOMETRY}, point_data, cell_data)


def has_same_geometry(frame: StoredFrame, other: StoredFrame) -> bool:
    """Tell whether two frames have the same pieces of the same mesh."""
    return all(np.array_equal(frame.geometry[name], other.geometry[name]) for name in GEOMETRY)


def partition_like(frame: StoredFrame, other: StoredFrame) -> StoredFrame:
    """Bring a frame's fields into the pieces of another one, where both have the same mesh.

    VTK's reader (9.7) loses pieces where steps have different numbers of them (docs/result-file.md), and geometry that
    stays is written once. The values at nodes and cells stay the same; a frame whose mesh is another one comes back as
    it is.
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


CHUNK_BYTES = 1 << 20
"""Of the datasets that grow by a frame at a time. Larger chunks read whole frames faster, single nodes slower."""


@dataclass(frozen=True)
class _Place:
    """Where the geometry of a step begins in the file: its parts, points, cells and connectivity."""

    part: int = 0
    point: int = 0
    cell: int = 0
    connectivity: int = 0


def join_frames(folder: SeriesFolder, numbers: Sequence[int], records: Sequence[str], origin: str,
                files: NewFiles) -> None:
    """Join result files of frames to one with steps, the result of ``folder``.

    Geometry that stays is written once: frames of one mesh are all written in the pieces of the first one. What is no
    field is kept by frame, so that each can be read as a result.

    ``numbers`` are those of the frames that were measured, from 1, in order, at least one; ``records`` those of all
    frames, measured or not, and ``origin`` what they were measured from, as JSON. ``files`` has the result take its
    name. Raises OSError where it cannot be written.
    """
    target = folder.result
    with new_hdf5(files.begin(target)) as file:
        with open_hdf5(folder.get_frame_path(numbers[0])) as first:
            for name in ("ddic_schema", "y_axis"):
                file.attrs[name] = first.attrs[name]
        file.attrs[schema.STATUS], file.attrs[schema.FAILURE] = schema.CONVERGED, ""
        group = file.create_group(schema.VTKHDF)
        group.attrs["Version"] = np.array(schema.VTKHDF_VERSION, np.int64)
        group.attrs.create("Type", np.bytes_("UnstructuredGrid"))
        geometry = _GrowingGeometry(group)
        fields = {kind: _GrowingFields(file.require_group(kind)) for kind in (schema.POINT_DATA, schema.CELL_DATA)}
        times = []
        for number in numbers:
            with open_hdf5(folder.get_frame_path(number)) as source:
                frame = geometry.add(read_stored_frame(source), source[schema.VTKHDF])
                for kind, values in ((schema.POINT_DATA, frame.point_data), (schema.CELL_DATA, frame.cell_data)):
                    fields[kind].add(values, source[kind])
                times.append(float(source[schema.TIME].attrs["deformed"]))
                _copy_rest(source, file.create_group(schema.frame_group(number)))
        _write_steps(group, geometry.places, times)
        for kind, growing in fields.items():
            growing.write_offsets(group["Steps"].create_group(f"{kind.rpartition('/')[2]}Offsets"))
        series = file.create_group(schema.SERIES)
        series.attrs["numbers"] = np.array(numbers, np.int64)
        series.attrs["origin"] = origin
        series["records"] = np.array(list(records), dtype=h5py.string_dtype())
        if schema.DISPLACEMENT_PHYSICAL in file[schema.POINT_DATA]:
            file.copy(file[f"{schema.frame_group(numbers[0])}/{schema.UNITS}"], file, schema.UNITS)
            write_physical_sidecar(target, file, files)
        else:
            files.remove_old(schema.physical_path(target))


class _GrowingGeometry:
    """Geometry of all steps one behind the other; what stays from one step to the next is written once."""

    def __init__(self, group: Any) -> None:
        self._group = group
        self._last: StoredFrame | None = None
        self.places: list[tuple[_Place, int]] = []

    def add(self, frame: StoredFrame, described: Any) -> StoredFrame:
        """Add that of a step, in the pieces of the last one where its mesh is the same; the frame in these pieces."""
        if self._last is not None:
            frame = partition_like(frame, self._last)
        if self._last is not None and has_same_geometry(frame, self._last):
            self.places.append(self.places[-1])
        else:
            self.places.append((self._append(frame.geometry, described), len(frame.geometry["NumberOfPoints"])))
        self._last = frame
        return frame

    def _append(self, geometry: Mapping[str, NDArray[Any]], described: Any) -> _Place:
        """Write it behind all others; where it begins."""
        if self._last is None:
            for name in GEOMETRY:
                _create_growing(self._group, name, geometry[name], described[name])
            return _Place()
        begin = _Place(*(len(self._group[name]) for name in ("NumberOfPoints", "Points", "Types", "Connectivity")))
        for name in GEOMETRY:
            _append(self._group[name], geometry[name])
        return begin


class _GrowingFields:
    """Fields of all steps one behind the other; what stays from one step to the next is written once."""

    def __init__(self, group: Any) -> None:
        self._group = group
        self._offsets: dict[str, list[int]] = {}
        self._last: dict[str, NDArray[Any]] = {}
        self._n_steps = 0

    def add(self, fields: Mapping[str, NDArray[Any]], described: Any) -> None:
        """Add those of a step; described: the datasets, whose attributes say what they are."""
        n_rows = len(next(iter(fields.values())))
        for name in sorted({*fields, *self._offsets}):
            values = fields.get(name)
            if values is None:
                # Not estimated in this frame.
                values = _make_unknown(self._last[name], n_rows)
            if name not in self._offsets:
                self._begin(name, values, described[name])
            if np.array_equal(values, self._last[name], equal_nan=values.dtype.kind == "f") and self._offsets[name]:
                self._offsets[name].append(self._offsets[name][-1])
                continue
            self._offsets[name].append(len(self._group[name]))
            _append(self._group[name], values)
            self._last[name] = values
        self._n_steps += 1

    def _begin(self, name: str, values: NDArray[Any], described: Any) -> None:
        """Make room for a field; earlier steps do not know it."""
        _create_growing(self._group, name, values[:0], described)
        self._offsets[name], self._last[name] = [], values[:0]
        if self._n_steps:
            self._last[name] = _make_unknown(values, len(values))
            _append(self._group[name], self._last[name])
            self._offsets[name] = [0] * self._n_steps

    def write_offsets(self, group: Any) -> None:
        """Write where each step's values begin."""
        for name, offsets in self._offsets.items():
            group[name] = np.array(offsets, np.int64)


def _make_unknown(like: NDArray[Any], n_rows: int) -> NDArray[Any]:
    """As many rows of nan, or of 0 where numbers are whole."""
    return np.full((n_rows, *like.shape[1:]), np.nan if like.dtype.kind == "f" else 0, dtype=like.dtype)


def _create_growing(group: Any, name: str, values: NDArray[Any], described: Any) -> None:
    row_bytes = max(1, values.dtype.itemsize * int(np.prod(values.shape[1:])))
    rows = max(1, min(len(described), CHUNK_BYTES // row_bytes))
    made = group.create_dataset(name, data=values, maxshape=(None, *values.shape[1:]),
                                chunks=(rows, *values.shape[1:]))
    for key, value in described.attrs.items():
        made.attrs[key] = value


def _append(dataset: Any, values: Any) -> None:
    n_before = len(dataset)
    dataset.resize(n_before + len(values), axis=0)
    dataset[n_before:] = values


def _copy_rest(source: Any, target: Any) -> None:
    """Copy what is neither geometry nor field, nor needed by later frames only."""
    for name in source:
        if name not in (schema.VTKHDF, schema.SERIES):
            source.copy(name, target)
    for key in (schema.STATUS, schema.FAILURE):
        target.attrs[key] = source.attrs[key]


def _write_steps(group: Any, places: Sequence[tuple[_Place, int]], times: Sequence[float]) -> None:
    """Where each step's geometry and fields begin, as VTKHDF wants it."""
    steps = group.create_group("Steps")
    steps.attrs["NSteps"] = len(times)
    steps["Values"] = np.array(times)
    steps["PartOffsets"] = np.array([place.part for place, _ in places], np.int64)
    steps["NumberOfParts"] = np.array([n_parts for _, n_parts in places], np.int64)
    steps["PointOffsets"] = np.array([place.point for place, _ in places], np.int64)
    # One column for each kind of cells that VTK keeps apart: one of an unstructured grid.
    steps["CellOffsets"] = np.array([[place.cell] for place, _ in places], np.int64)
    steps["ConnectivityIdOffsets"] = np.array([[place.connectivity] for place, _ in places], np.int64)
