"""One result file of many: the frames of a series as steps of a VTKHDF file, which ParaView plays.

A frame of a series as its file holds it, and the same in the pieces of another frame of its mesh.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ddic.arrays import IntArray
from ddic.io import result_schema as schema
from ddic.io.damaged_result import open_hdf5
from ddic.io.hdf5_stream import new_hdf5
from ddic.io.replace_on_exit import NewFiles
from ddic.io.result_reader import merge_pieces
from ddic.io.series_folder import SeriesFolder
from ddic.io.sidecars import write_physical_sidecar

Arrays = Mapping[str, NDArray[Any]]

GEOMETRY = ("Points", *schema.TOPOLOGY)


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

    geometry: Arrays
    point_data: Arrays
    cell_data: Arrays


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


def _find_rows(ids: IntArray, wanted: IntArray) -> NDArray[np.intp] | None:
    """Where numbers stand first; None where they are not the same ones."""
    known, first = np.unique(ids, return_index=True)
    if not np.array_equal(known, np.unique(wanted)):
        return None
    rows: NDArray[np.intp] = first[np.searchsorted(known, wanted)]
    return rows


def _has_same_mesh(frame: StoredFrame, other: StoredFrame) -> bool:
    """Whether the pieces joined are the same nodes and cells, bit by bit."""
    one, two = (merge_pieces(each.geometry, each.geometry["Points"], each.point_data[schema.GLOBAL_NODE_ID],
                             each.cell_data[schema.GLOBAL_CELL_ID])[0] for each in (frame, other))
    return all(np.array_equal(getattr(one, name), getattr(two, name))
               for name in ("nodes", "connectivity", "offsets", "types"))


CHUNK_BYTES = 1 << 20
"""Of the datasets that grow by a frame at a time. Larger chunks read whole frames faster, single nodes slower."""


_STARTS = {"PartOffsets": "NumberOfPoints", "PointOffsets": "Points", "CellOffsets": "Types",
           "ConnectivityIdOffsets": "Connectivity"}
"""Names of the rows at which a step begins, and a dataset that each is of."""

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
    with new_hdf5(files.begin(target)) as (file, _):
        with open_hdf5(folder.get_frame_path(numbers[0])) as first:
            schema.copy_attributes(first, file, schema.OF_FORMAT)
        file.attrs[schema.STATUS], file.attrs[schema.FAILURE] = schema.CONVERGED, ""
        group = schema.create_vtk_group(file, "UnstructuredGrid")
        geometry = _GrowingGeometry(group)
        fields = {kind: _GrowingFields(file.require_group(kind)) for kind in (schema.POINT_DATA, schema.CELL_DATA)}
        times = []
        for number in numbers:
            with open_hdf5(folder.get_frame_path(number)) as source:
                frame = geometry.add(read_stored_frame(source), source[schema.VTKHDF])
                for kind, values in ((schema.POINT_DATA, frame.point_data), (schema.CELL_DATA, frame.cell_data)):
                    fields[kind].add(values, source[kind])
                times.append(float(source[schema.TIME].attrs["deformed"]))
                # What is neither geometry nor field, nor needed by later frames only.
                rest = file.create_group(schema.frame_group(number))
                for name in sorted(source.keys() - {schema.VTKHDF, schema.SERIES}):
                    source.copy(name, rest)
                schema.copy_attributes(source, rest, schema.OF_STATUS)
        steps = group.create_group("Steps")
        steps.attrs["NSteps"] = len(times)
        steps["Values"] = np.array(times)
        geometry.write_starts(steps)
        for kind, growing in fields.items():
            growing.write_starts(steps.create_group(f"{kind.rpartition('/')[2]}Offsets"))
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
        self._starts: dict[str, list[int]] = {name: [] for name in _STARTS}
        self._n_parts: list[int] = []

    def add(self, frame: StoredFrame, described: Any) -> StoredFrame:
        """Add that of a step, in the pieces of the last one where its mesh is the same; the frame in these pieces."""
        if self._last is not None:
            frame = partition_like(frame, self._last)
        stays = self._last is not None and has_same_geometry(frame, self._last)
        for name, counted in _STARTS.items():
            starts = self._starts[name]
            n_before = len(self._group[counted]) if counted in self._group else 0
            starts.append(starts[-1] if stays else n_before)
        self._n_parts.append(len(frame.geometry["NumberOfPoints"]))
        if not stays:
            for name in GEOMETRY:
                _append(self._group, name, frame.geometry[name], described[name])
        self._last = frame
        return frame

    def write_starts(self, steps: Any) -> None:
        """Write where each step's geometry begins, as VTKHDF wants it."""
        steps["NumberOfParts"] = np.array(self._n_parts, np.int64)
        for name, starts in self._starts.items():
            rows = np.array(starts, np.int64)
            # One column for each kind of cells that VTK keeps apart: one of an unstructured grid.
            steps[name] = rows[:, None] if name in ("CellOffsets", "ConnectivityIdOffsets") else rows


class _GrowingFields:
    """Fields of all steps one behind the other; what stays from one step to the next is written once."""

    def __init__(self, group: Any) -> None:
        self._group = group
        self._offsets: dict[str, list[int]] = {}
        self._last: dict[str, NDArray[Any]] = {}
        self._n_steps = 0

    def add(self, fields: Arrays, described: Any) -> None:
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
            _append(self._group, name, values, described[name])
            self._last[name] = values
        self._n_steps += 1

    def _begin(self, name: str, values: NDArray[Any], described: Any) -> None:
        """Make room for a field; earlier steps do not know it."""
        self._last[name] = _make_unknown(values, len(values) if self._n_steps else 0)
        self._offsets[name] = [0] * self._n_steps
        _append(self._group, name, self._last[name], described)

    def write_starts(self, group: Any) -> None:
        """Write where each step's values begin."""
        for name, offsets in self._offsets.items():
            group[name] = np.array(offsets, np.int64)


def _make_unknown(like: NDArray[Any], n_rows: int) -> NDArray[Any]:
    """As many rows of nan, or of 0 where numbers are whole."""
    return np.full((n_rows, *like.shape[1:]), np.nan if like.dtype.kind == "f" else 0, dtype=like.dtype)


def _append(group: Any, name: str, values: NDArray[Any], described: Any) -> None:
    """Write values behind those of a dataset, which is made where there is none yet, with the attributes of another."""
    if name not in group:
        row_bytes = max(1, values.dtype.itemsize * int(np.prod(values.shape[1:])))
        rows = max(1, min(len(described), CHUNK_BYTES // row_bytes))
        made = group.create_dataset(name, data=values, maxshape=(None, *values.shape[1:]),
                                    chunks=(rows, *values.shape[1:]))
        made.attrs.update(described.attrs)
        return
    dataset = group[name]
    n_before = len(dataset)
    dataset.resize(n_before + len(values), axis=0)
    dataset[n_before:] = values
