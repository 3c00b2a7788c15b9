"""Writes the result file piece by piece, in the VTKHDF layout (UnstructuredGrid, one piece per subdomain)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import h5py
import numpy as np
from numpy.typing import DTypeLike, NDArray

from ddic.io import result_schema as schema
from ddic.io.replace_on_exit import replaced_on_exit
from ddic.io.residual_sidecar import write_sidecar
from ddic.io.result_schema import FieldSpec

CHUNK_ROWS = 16384
IMAGE_CHUNK = 256
CHUNK_CACHE_BYTES = 64 << 20


@dataclass(frozen=True)
class PieceSize:
    """Sizes of a subdomain's piece; n_connectivity: sum of the nodes per cell."""

    n_points: int
    n_cells: int
    n_connectivity: int


@dataclass(frozen=True)
class Piece:
    """A subdomain's mesh and fields.

    points: (n_points, dim) pixels, y down. connectivity: (n_connectivity,) numbers of the piece's own points.
    offsets: (n_cells + 1,). types: (n_cells,) VTK cell types.
    point_data, cell_data: name -> (n,) scalars, (n, dim) or (n, 3) vectors, (n, 6) symmetric tensors.
    """

    points: NDArray[np.float64]
    connectivity: NDArray[np.int64]
    offsets: NDArray[np.int64]
    types: NDArray[np.uint8]
    point_data: Mapping[str, NDArray[Any]]
    cell_data: Mapping[str, NDArray[Any]]


class ResultWriter:
    """A result file under construction; use it in a ``with`` statement.

    path: final name, taken only when all pieces are written and the block ends without an exception.
    sizes: of all pieces. point_fields, cell_fields: what every piece brings. flip_y: write y upwards.
    """

    def __init__(self, path: Path, sizes: Sequence[PieceSize], point_fields: Sequence[FieldSpec],
                 cell_fields: Sequence[FieldSpec], *, flip_y: bool) -> None:
        self._path = Path(path)
        self._sizes = tuple(sizes)
        self._point_fields = tuple(point_fields)
        self._cell_fields = tuple(cell_fields)
        self._flip_y = flip_y
        self._written: set[int] = set()
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            temporary = stack.enter_context(replaced_on_exit(self._path))
            self._file = stack.enter_context(h5py.File(temporary, "w", rdcc_nbytes=CHUNK_CACHE_BYTES))
            self._create_grid()
            self._stack = stack.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        if error is not None:
            self._stack.__exit__(kind, error, trace)
            return
        with self._stack:
            missing = sorted(set(range(len(self._sizes))) - self._written)
            if missing:
                raise ValueError(f"{self._path}: pieces {missing} were not written")
            image_shape = self._residual.shape if self._has_residual else None
        sidecar = schema.sidecar_path(self._path)
        if image_shape is None:
            # One of an earlier run would point to an image that is no longer there.
            sidecar.unlink(missing_ok=True)
        else:
            write_sidecar(self._path, width=image_shape[1], height=image_shape[0], flip_y=self._flip_y)

    def write_piece(self, index: int, piece: Piece) -> None:
        """Write the mesh and fields of one piece.

        Raises ValueError if the piece was written before, or if its arrays do not have the announced shapes.
        """
        if index in self._written:
            raise ValueError(f"piece {index} was written before")
        size = self._sizes[index]
        for what, found, expected in (("points", len(piece.points), size.n_points),
                                      ("types", len(piece.types), size.n_cells),
                                      ("offsets", len(piece.offsets), size.n_cells + 1),
                                      ("connectivity", len(piece.connectivity), size.n_connectivity)):
            if found != expected:
                raise ValueError(f"piece {index}: {found} {what}, {expected} announced")
        start = self._start(index)
        group = self._file[schema.VTKHDF]
        points = _three_components(np.asarray(piece.points, np.float64))
        _put(group["Points"], start.n_points, self._oriented(points))
        _put(group["Connectivity"], start.n_connectivity, piece.connectivity)
        _put(group["Offsets"], start.n_cells + index, piece.offsets)
        _put(group["Types"], start.n_cells, piece.types)
        self._write_fields(schema.POINT_DATA, self._point_fields, piece.point_data,
                           start.n_points, size.n_points)
        self._write_fields(schema.CELL_DATA, self._cell_fields, piece.cell_data, start.n_cells, size.n_cells)
        self._written.add(index)

    def create_residual_image(self, width: int, height: int) -> None:
        """Make room for the residual image (pixels); it is NaN where no strip is written."""
        chunks = (min(IMAGE_CHUNK, height), min(IMAGE_CHUNK, width))
        data = self._file.create_dataset(f"{schema.RESIDUAL_IMAGE}/{schema.RESIDUAL}", (height, width),
                                         np.float32, chunks=chunks, compression="gzip", compression_opts=1,
                                         shuffle=True, fillvalue=np.nan)
        data.attrs["unit"] = "grey level"
        data.attrs["description"] = "f(x) - g(x + u), NaN where not correlated; rows go down"
        self._file[schema.RESIDUAL_IMAGE].attrs["origin"] = np.zeros(2)

    def write_residual_strip(self, y0: int, strip: NDArray[np.float32]) -> None:
        """Write rows y0, y0 + 1, ... of the residual image; strip: (rows, width), NaN: not correlated."""
        height, width = self._residual.shape
        if strip.ndim != 2 or strip.shape[1] != width or y0 < 0 or y0 + len(strip) > height:
            raise ValueError(f"strip of shape {strip.shape} at row {y0} in an image of {width} x {height} px")
        self._residual[y0:y0 + len(strip)] = strip

    def write_table(self, group: str, columns: Mapping[str, Sequence[Any] | NDArray[Any]]) -> None:
        """Write a table, one dataset per column; all columns have the same length."""
        arrays = {name: np.asarray(column) for name, column in columns.items()}
        if len({len(array) for array in arrays.values()}) > 1:
            raise ValueError(f"{group}: columns of different lengths")
        target = self._file.require_group(group)
        for name, array in arrays.items():
            target[name] = array

    def write_curves(self, group: str, curves: Sequence[Sequence[float] | NDArray[np.float64]]) -> None:
        """Write arrays of different lengths as datasets 0000, 0001, ..."""
        target = self._file.require_group(group)
        for number, curve in enumerate(curves):
            target[f"{number:04d}"] = np.asarray(curve, np.float64)

    def write_attributes(self, group: str, values: Mapping[str, Any]) -> None:
        """Write texts, numbers and lists of them as attributes of a group."""
        target = self._file.require_group(group)
        for name, value in values.items():
            target.attrs[name] = value

    @property
    def _has_residual(self) -> bool:
        return schema.RESIDUAL_IMAGE in self._file

    @property
    def _residual(self) -> Any:
        if not self._has_residual:
            raise ValueError("create_residual_image comes before write_residual_strip")
        return self._file[schema.RESIDUAL_IMAGE][schema.RESIDUAL]

    def _start(self, index: int) -> PieceSize:
        before = self._sizes[:index]
        return PieceSize(sum(s.n_points for s in before), sum(s.n_cells for s in before),
                         sum(s.n_connectivity for s in before))

    def _oriented(self, values: NDArray[Any]) -> NDArray[Any]:
        return schema.flip_components(values) if self._flip_y else values

    def _create_grid(self) -> None:
        total = self._start(len(self._sizes))
        self._file.attrs["ddic_schema"] = schema.SCHEMA_VERSION
        self._file.attrs["y_axis"] = "up" if self._flip_y else "down"
        group = self._file.create_group(schema.VTKHDF)
        group.attrs["Version"] = np.array(schema.VTKHDF_VERSION, np.int64)
        # VTK's reader wants fixed-length ASCII here, not h5py's variable-length UTF-8.
        group.attrs.create("Type", np.bytes_("UnstructuredGrid"))
        for name, counts in (("NumberOfPoints", [s.n_points for s in self._sizes]),
                             ("NumberOfCells", [s.n_cells for s in self._sizes]),
                             ("NumberOfConnectivityIds", [s.n_connectivity for s in self._sizes])):
            _create(group, name, len(counts), 1, np.int64)[...] = counts
        _create(group, "Points", total.n_points, 3, np.float64).attrs["unit"] = "px"
        _create(group, "Connectivity", total.n_connectivity, 1, np.int64)
        _create(group, "Offsets", total.n_cells + len(self._sizes), 1, np.int64)
        _create(group, "Types", total.n_cells, 1, np.uint8)
        for name, fields, length in ((schema.POINT_DATA, self._point_fields, total.n_points),
                                     (schema.CELL_DATA, self._cell_fields, total.n_cells)):
            data = self._file.create_group(name)
            for field in fields:
                created = _create(data, field.name, length, field.n_components, field.dtype)
                created.attrs["unit"] = field.unit
                created.attrs["description"] = field.description

    def _write_fields(self, group: str, fields: Sequence[FieldSpec], arrays: Mapping[str, NDArray[Any]],
                      start: int, length: int) -> None:
        names = {field.name for field in fields}
        if names != set(arrays):
            raise ValueError(f"{group}: fields {sorted(arrays)}, {sorted(names)} announced")
        for field in fields:
            values = np.asarray(arrays[field.name])
            if field.n_components == schema.VECTOR:
                values = _three_components(values)
            expected = (length,) if field.n_components == 1 else (length, field.n_components)
            if values.shape != expected:
                raise ValueError(f"{group}/{field.name}: shape {values.shape}, {expected} announced")
            _put(self._file[group][field.name], start, self._oriented(values))


def _create(group: Any, name: str, length: int, n_components: int, dtype: DTypeLike) -> Any:
    """A dataset that can grow by steps."""
    columns = () if n_components == 1 else (n_components,)
    return group.create_dataset(name, (length, *columns), dtype, maxshape=(None, *columns),
                                chunks=(max(1, min(length, CHUNK_ROWS)), *columns))


def _put(dataset: Any, start: int, values: NDArray[Any]) -> None:
    dataset[start:start + len(values)] = values


def _three_components(vectors: NDArray[Any]) -> NDArray[Any]:
    if vectors.ndim != 2 or vectors.shape[1] > 3:
        raise ValueError(f"vectors of shape {vectors.shape}, (n, dim) expected")
    return np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))
