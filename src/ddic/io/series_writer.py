"""The files of a series: a folder with one for each finished frame, and the result file to which they are joined.

The folder holds beside them what the next frame needs. Files are written while the program goes on, one after the
other; others are brought into the system's cache before they are needed. In the result file the frames are steps of a
VTKHDF file, which ParaView plays.
"""

import json
import shutil
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, IntArray
from ddic.errors import InputError
from ddic.io import result_schema as schema
from ddic.io.hdf5_file import Arrays, open_hdf5
from ddic.io.new_hdf5 import new_hdf5
from ddic.io.replace_on_exit import NewFiles, made_folder, remove_abandoned, replaced_on_exit
from ddic.io.result_reader import merge_pieces
from ddic.io.result_writer import write_physical_sidecar

ORIGIN = "series.json"
"""What the frames in a folder were measured from."""


@dataclass(frozen=True)
class FrameState:
    """What frames after a finished one need of it.

    Attributes
    ----------
    time : float
        Unit chosen by the user.
    unknowns : dict of int to (n_unknowns,) array
        By subdomain, since the first reference image.
    noise : tuple of float
        By which cameras are weighted, grey levels; empty with one camera.
    shown_share : float
        Share of the cells that were seen where the field put them.
    holds_back : bool
        Whether mechanics held cells back from where they were seen, so that the field shows no way to the next frame.
    """

    time: float
    unknowns: Mapping[int, Array]
    noise: tuple[float, ...]
    shown_share: float
    holds_back: bool


@dataclass(frozen=True)
class SeriesFolder:
    """Where the frames of a series stand until all are finished.

    Attributes
    ----------
    result : Path
        The result file of the whole series.
    n_frames : int
        That are to be measured.
    """

    result: Path
    n_frames: int

    @property
    def path(self) -> Path:
        """The folder, beside the result."""
        return schema.frames_path(self.result)

    def get_frame_path(self, number: int) -> Path:
        """Name the file of a finished frame, numbered from 1: a result file."""
        return self.path / f"{number:06d}.vtkhdf"

    def get_failure_path(self, number: int) -> Path:
        """Name the file that says why a frame, numbered from 1, could not be measured: its record."""
        return self.path / f"{number:06d}.failed.json"

    def begin(self, origin: Mapping[str, object], *, resume: bool) -> dict[int, str]:
        """Make the folder, or look what an earlier run left in it, and return records of the finished frames by number.

        ``origin`` is what the series is measured from, as JSON has it; ``resume`` asks to go on from what is there.
        Raises InputError where another series stands there, or one that shall not be gone on with.
        """
        if not self.path.exists():
            finished = self._read_whole(origin) if resume else {}
            if finished:
                return finished
            with made_folder(self.path):
                _write(self.path / ORIGIN, json.dumps(origin).encode())
            return {}
        remove_abandoned(self.path)
        self._require_same(origin)
        finished = self._list_finished()
        if not resume and finished:
            raise InputError(f"{self.path} holds {len(finished)} of {self.n_frames} frames of a series that was not "
                             "finished: go on with --resume, or remove the folder to begin anew")
        return finished

    def _read_whole(self, origin: Mapping[str, object]) -> dict[int, str]:
        """Records of a series that an earlier run has finished; none where there is another file, or no file."""
        if not self.result.is_file() or not h5py.is_hdf5(self.result):
            return {}
        with open_hdf5(self.result) as file:
            if schema.STEPS not in file or file[schema.SERIES].attrs["origin"] != json.dumps(origin):
                return {}
            records = file[schema.SERIES]["records"].asstr()[...]
        return dict(enumerate(records, start=1)) if len(records) == self.n_frames else {}

    def _require_same(self, origin: Mapping[str, object]) -> None:
        try:
            before = json.loads((self.path / ORIGIN).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise InputError(f"{self.path}: stands where the frames of this series are kept, but is no such folder "
                             f"({error}); remove it, or choose another output.file") from error
        changed = sorted(key for key in {*before, *origin} if before.get(key) != origin.get(key))
        if changed:
            raise InputError(f"{self.path} holds frames of another series ({', '.join(changed)} differ); remove the "
                             "folder to begin anew, or choose another output.file")

    def _list_finished(self) -> dict[int, str]:
        found = {}
        for number in range(1, self.n_frames + 1):
            failed, finished = self.get_failure_path(number), self.get_frame_path(number)
            if finished.is_file():
                with open_hdf5(finished) as file:
                    found[number] = str(file[schema.SERIES].attrs["record"])
            elif failed.is_file():
                found[number] = failed.read_text(encoding="utf-8")
        return found

    def read_state(self, number: int) -> FrameState:
        """Read what the next frame needs of a finished one, numbered from 1: of all subdomains."""
        with open_hdf5(self.get_frame_path(number)) as file:
            group = file[schema.SERIES]
            unknowns = {int(name): values[...] for name, values in group["unknowns"].items()}
            return FrameState(float(group.attrs["time"]), unknowns, tuple(map(float, group.attrs["noise"])),
                              float(group.attrs["shown_share"]), bool(group.attrs["holds_back"]))

    def write_failure(self, number: int, record: str) -> None:
        """Note that a frame, numbered from 1, could not be measured; ``record`` says why, as JSON."""
        _write(self.get_failure_path(number), record.encode())

    def remove(self) -> None:
        """Remove the folder with everything in it."""
        shutil.rmtree(self.path)


class BackgroundWriter(ThreadPoolExecutor):
    """Writes files in a thread of its own; use it in a ``with`` statement, which waits for the last one."""

    def __init__(self) -> None:
        super().__init__(max_workers=1, thread_name_prefix="ddic-writer")
        self._pending: Future[None] | None = None

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        self.shutdown(wait=True)
        if error is None:
            self.wait()

    def write(self, path: Path, content: bytes) -> None:
        """Begin to write a file once the last one is written; raises OSError or InputError where that could not be."""
        self.wait()
        self._pending = self.submit(_write, path, content)

    def wait(self) -> None:
        """Wait for what is being written; raises OSError or InputError where it could not be."""
        pending, self._pending = self._pending, None
        if pending is not None:
            pending.result()


def _write(path: Path, content: bytes) -> None:
    with replaced_on_exit(path) as temporary:
        temporary.write_bytes(content)


CHUNK = 1 << 22
"""Bytes read at a time. Larger ones keep the disk busier, smaller ones stop sooner."""


class ReadAhead(ThreadPoolExecutor):
    """Reads files in a thread of its own and drops what it reads; use it in a ``with`` statement."""

    def __init__(self) -> None:
        super().__init__(max_workers=1, thread_name_prefix="ddic-reader")

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        self.shutdown(wait=True, cancel_futures=True)

    def begin(self, paths: Iterable[Path]) -> None:
        """Begin to read files; one that cannot be read is told of by whoever needs it."""
        for path in paths:
            self.submit(_read, path)


def _read(path: Path) -> None:
    try:
        with path.open("rb", buffering=0) as file:
            while file.read(CHUNK):
                pass
    except OSError:
        return


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
"""Names of the rows at which a step begins, and the dataset that each is of."""


class _GrowingRows:
    """Datasets of all steps one behind the other; what stays from one step to the next is written once.

    ``starts`` are the rows at which the values of each step begin, by the name of the dataset.
    """

    def __init__(self, group: Any) -> None:
        self.starts: dict[str, list[int]] = {}
        self._group = group
        self._last: dict[str, NDArray[Any]] = {}
        self._n_steps = 0

    def add(self, name: str, values: NDArray[Any], described: Any, *, stays: bool) -> None:
        """Add the values of a step; the attributes of the dataset ``described`` say what they are."""
        starts = self.starts.setdefault(name, [])
        if stays:
            starts.append(starts[-1])
            return
        starts.append(len(self._group[name]) if name in self._group else 0)
        _append(self._group, name, values, described)
        self._last[name] = values

    def add_fields(self, fields: Arrays, described: Any) -> None:
        """Add the fields of a step; one that another step does not have, since it was not estimated, is unknown."""
        n_rows = len(next(iter(fields.values())))
        for name in sorted({*fields, *self.starts}):
            values = _make_unknown(self._last[name], n_rows) if name not in fields else fields[name]
            if name not in self.starts and self._n_steps:
                self.add(name, _make_unknown(values, n_rows), described[name], stays=False)
                self.starts[name] = [0] * self._n_steps
            stays = name in self._last and np.array_equal(values, self._last[name], equal_nan=values.dtype.kind == "f")
            self.add(name, values, described.get(name), stays=stays)
        self._n_steps += 1


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
    with new_hdf5(files.begin(target)) as new:
        file = new.file
        with open_hdf5(folder.get_frame_path(numbers[0])) as first:
            file.attrs.update({name: first.attrs[name] for name in schema.OF_FORMAT})
        file.attrs[schema.STATUS], file.attrs[schema.FAILURE] = schema.CONVERGED, ""
        group = schema.create_vtk_group(file, "UnstructuredGrid")
        geometry, times, n_parts = _GrowingRows(group), [], []
        fields = {kind: _GrowingRows(file.require_group(kind)) for kind in (schema.POINT_DATA, schema.CELL_DATA)}
        last: StoredFrame | None = None
        for number in numbers:
            with open_hdf5(folder.get_frame_path(number)) as source:
                frame = read_stored_frame(source)
                # In the pieces of the last one, where its mesh is the same.
                frame = frame if last is None else partition_like(frame, last)
                stays = last is not None and has_same_geometry(frame, last)
                for name, values in frame.geometry.items():
                    geometry.add(name, values, source[schema.VTKHDF][name], stays=stays)
                fields[schema.POINT_DATA].add_fields(frame.point_data, source[schema.POINT_DATA])
                fields[schema.CELL_DATA].add_fields(frame.cell_data, source[schema.CELL_DATA])
                last = frame
                n_parts.append(len(frame.geometry["NumberOfPoints"]))
                times.append(float(source[schema.TIME].attrs["deformed"]))
                # What is neither geometry nor field, nor needed by later frames only.
                rest = file.create_group(schema.frame_group(number))
                for name in sorted(source.keys() - {schema.VTKHDF, schema.SERIES}):
                    source.copy(name, rest)
                # Frames of an older run have no verdict.
                rest.attrs.update({name: source.attrs[name] for name in (*schema.OF_STATUS, *schema.OF_VERDICT)
                                   if name in source.attrs})
        steps = group.create_group("Steps")
        steps.attrs["NSteps"] = len(times)
        steps["Values"] = np.array(times)
        steps["NumberOfParts"] = np.array(n_parts, np.int64)
        _write_starts(steps, geometry, fields)
        series = file.create_group(schema.SERIES)
        series.attrs["numbers"] = np.array(numbers, np.int64)
        series.attrs["origin"] = origin
        series["records"] = np.array(list(records), dtype=h5py.string_dtype())
        if schema.DISPLACEMENT_PHYSICAL in file[schema.POINT_DATA]:
            file.copy(file[f"{schema.frame_group(numbers[0])}/{schema.UNITS}"], file, schema.UNITS)
            write_physical_sidecar(target, file, files)
        else:
            files.remove_old(schema.physical_path(target))


def _write_starts(steps: Any, geometry: _GrowingRows, fields: Mapping[str, _GrowingRows]) -> None:
    """Write where the geometry and the fields of each step begin, as VTKHDF wants it."""
    for name, counted in _STARTS.items():
        rows = np.array(geometry.starts[counted], np.int64)
        # One column for each kind of cells that VTK keeps apart: one of an unstructured grid.
        steps[name] = rows[:, None] if name in ("CellOffsets", "ConnectivityIdOffsets") else rows
    for kind, growing in fields.items():
        offsets = steps.create_group(f"{kind.rpartition('/')[2]}Offsets")
        for name, starts in growing.starts.items():
            offsets[name] = np.array(starts, np.int64)


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
