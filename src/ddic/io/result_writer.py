"""Writes the result file piece by piece, in the VTKHDF layout (UnstructuredGrid, one piece per subdomain).

And what stands beside it: the summary, and small VTKHDF files. One shows the result in its length unit: points, and
displacements that match them. ImageData files show the residual images kept in the result file. A result and what
stands beside it are moved or removed together.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

import h5py
import numpy as np
from numpy.typing import DTypeLike, NDArray

from ddic.arrays import Array, IntArray
from ddic.io import result_schema as schema
from ddic.io.hdf5_file import Arrays, ChunkGrid, new_hdf5, open_hdf5
from ddic.io.replace_on_exit import NewFiles, replaced_together
from ddic.io.result_reader import Result, read_open_file
from ddic.io.result_schema import FieldSpec
from ddic.io.text_files import write_json
from ddic.separated.field import SeparatedField

CHUNK_CACHE_BYTES = 64 << 20


class PieceSize(NamedTuple):
    """Sizes of a subdomain's piece.

    Attributes
    ----------
    n_points, n_cells, n_connectivity : int
        Nodes, cells, and the sum of the nodes per cell.
    """

    n_points: int
    n_cells: int
    n_connectivity: int


@dataclass(frozen=True)
class Piece:
    """A subdomain's mesh and fields, or those of several subdomains that follow each other.

    Attributes
    ----------
    points : (n_points, dim) array
        Pixels, y down.
    connectivity : (n_connectivity,) array
        Numbers of the piece's own points.
    offsets : (n_cells + 1,) array
        Of each piece.
    types : (n_cells,) array
        VTK cell types.
    point_data, cell_data : dict of (n,), (n, dim), (n, 3) or (n, 6) array
        By name: scalars, vectors, symmetric tensors.
    """

    points: Array
    connectivity: IntArray
    offsets: IntArray
    types: NDArray[np.uint8]
    point_data: Arrays
    cell_data: Arrays


class ResultWriter:
    """A result file under construction; use it in a ``with`` statement.

    What a measurement is made of is up to it: pieces of a mesh with fields (``create_pieces``, ``write_pieces``),
    images, tables, curves, attributes.

    Parameters
    ----------
    path : Path or None
        Final name, taken only when all pieces announced are written and the block ends without an exception; None
        for a file in memory, which ``read_back`` reads.
    flip_y : bool
        Write y upwards.
    files : NewFiles, optional
        With which the file and what stands beside it take their names; by default they do so by themselves.
    """

    def __init__(self, path: Path | None, *, flip_y: bool = False, files: NewFiles | None = None) -> None:
        self._path = path
        self._flip_y = flip_y
        self._files = files
        # What lies before each of the announced pieces, and at last all of them.
        self._starts: list[list[int]] = []
        # Datasets of the fields at the points and on the cells, beside what they are.
        self._fields: dict[str, list[tuple[FieldSpec, Any]]] = {}
        self._written: set[int] = set()
        self._grids: list[ChunkGrid] = []
        # Raises where the disk has refused a part: what is still to come would be kept in memory.
        self._require_written: Callable[[], None] = lambda: None

    def __enter__(self) -> Self:
        self._opened = self._open()
        self._opened.__enter__()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self._opened.__exit__(kind, error, trace)

    @contextmanager
    def _open(self) -> Iterator[None]:
        """Open the file under its temporary name, or in memory, and complete it where the block does not fail."""
        with ExitStack() as stack:
            if self._path is None:
                self._file = stack.enter_context(h5py.File("in memory", "w", driver="core", backing_store=False))
            else:
                files = self._files or stack.enter_context(replaced_together())
                self._file, self._require_written = stack.enter_context(
                    new_hdf5(files.begin(self._path), CHUNK_CACHE_BYTES))
            schema.begin_file(self._file, flipped=self._flip_y)
            yield
            self._refuse_missing_pieces()
            if self._path is not None:
                self._write_company(self._path, files)

    def _write_company(self, path: Path, files: NewFiles) -> None:
        """Write what shows the residual images and the length unit."""
        if not self._grids:
            # One of an earlier run would point to an image that is no longer there.
            files.remove_old(schema.sidecar_path(path))
        for camera, grid in enumerate(self._grids):
            write_sidecar(path, camera, width=grid.width, height=grid.height, flip_y=self._flip_y, files=files)
        if schema.UNITS in self._file and schema.DISPLACEMENT_PHYSICAL in self._file.get(schema.POINT_DATA, ()):
            write_physical_sidecar(path, self._file, files)
        else:
            files.remove_old(schema.physical_path(path))

    def read_back(self) -> Result:
        """Read what was written, with the residual image, to memory while the file is open."""
        self._refuse_missing_pieces()
        return read_open_file(Path(), self._file)

    def read_image(self) -> bytes:
        """Read the content of a file in memory, as it would be on the disk."""
        self._refuse_missing_pieces()
        self._file.flush()
        return bytes(self._file.id.get_file_image())

    def create_pieces(self, sizes: Sequence[PieceSize], point_fields: Sequence[FieldSpec],
                      cell_fields: Sequence[FieldSpec]) -> None:
        """Make room for a mesh in pieces of these sizes, all of them, and for the fields that every piece brings."""
        counts = np.array(sizes, np.int64).reshape(-1, 3)
        self._starts = np.cumsum([(0, 0, 0), *counts], axis=0).tolist()
        n_points, n_cells, n_connectivity = self._starts[-1]
        group = schema.create_vtk_group(self._file, "UnstructuredGrid")
        for name, of_pieces in zip(schema.PIECES, counts.T, strict=True):
            group[name] = of_pieces
        _create(group, "Points", n_points, 3, np.float64).attrs["unit"] = "px"
        _create(group, "Connectivity", n_connectivity, 1, np.int64)
        # Each piece has one offset more than cells.
        _create(group, "Offsets", n_cells + len(sizes), 1, np.int64)
        _create(group, "Types", n_cells, 1, np.uint8)
        self._create_fields(schema.POINT_DATA, point_fields, n_points)
        self._create_fields(schema.CELL_DATA, cell_fields, n_cells)

    def write_pieces(self, indices: range, pieces: Piece) -> None:
        """Write the mesh and fields of some pieces that follow each other.

        ``indices`` are their numbers, ``pieces`` is all of them joined to one (``join_pieces``). Raises ValueError if
        one was written before, or if the arrays do not have the announced shapes.
        """
        if not self._starts:
            raise ValueError("create_pieces comes before write_pieces")
        again = sorted(self._written.intersection(indices))
        if again:
            raise ValueError(f"pieces {again} were written before")
        start, stop = self._starts[indices.start], self._starts[indices.stop]
        point, cell, connectivity = start
        n_points, n_cells, n_connectivity = (end - begin for begin, end in zip(start, stop, strict=True))
        sizes = {"points": n_points, "types": n_cells, "offsets": n_cells + len(indices),
                 "connectivity": n_connectivity}
        for what, announced in sizes.items():
            found = len(getattr(pieces, what))
            if found != announced:
                raise ValueError(f"pieces {indices}: {found} {what}, {announced} announced")
        group = self._file[schema.VTKHDF]
        points = _three_components(np.asarray(pieces.points, np.float64))
        _put(group["Points"], point, self._oriented(points))
        _put(group["Connectivity"], connectivity, pieces.connectivity)
        _put(group["Offsets"], cell + indices.start, pieces.offsets)
        _put(group["Types"], cell, pieces.types)
        self._write_fields(schema.POINT_DATA, pieces.point_data, point, n_points)
        self._write_fields(schema.CELL_DATA, pieces.cell_data, cell, n_cells)
        self._require_written()
        self._written.update(indices)

    def create_residual_image(self, grid: ChunkGrid) -> None:
        """Make room for the next camera's residual image; it is NaN where no chunk is written."""
        group = schema.residual_group(len(self._grids))
        data = self._file.create_dataset(f"{group}/{schema.RESIDUAL}", (grid.height, grid.width),
                                         "<f4", chunks=grid.shape, compression="gzip", compression_opts=1,
                                         shuffle=True, fillvalue=np.nan)
        data.attrs.update(unit="grey level", description="f(x) - g(x + u), NaN where not correlated; rows go down")
        self._file[group].attrs["origin"] = np.zeros(2)
        self._grids.append(grid)
        self._residual = data.id

    def write_residual_chunk(self, number: int, data: bytes) -> None:
        """Write one chunk of the last residual image, as ``pack_chunk`` makes it; it is not unpacked here.

        Raises ValueError if there is no residual image yet.
        """
        if not self._grids:
            raise ValueError("create_residual_image comes before write_residual_chunk")
        window = self._grids[-1].locate_chunk(number)
        self._residual.write_direct_chunk((window.y0, window.x0), data)
        self._require_written()

    def write_table(self, group: str, columns: Mapping[str, Sequence[Any] | NDArray[Any]]) -> None:
        """Write a table, one dataset per column of numbers or texts.

        Raises ValueError if columns have different lengths.
        """
        arrays = {name: np.asarray(column) for name, column in columns.items()}
        if len({len(array) for array in arrays.values()}) > 1:
            raise ValueError(f"{group}: columns of different lengths")
        self.write_arrays(group, {name: array.astype(h5py.string_dtype()) if array.dtype.kind == "U" else array
                                  for name, array in arrays.items()})

    def write_curves(self, group: str, curves: Sequence[Sequence[float] | Array]) -> None:
        """Write arrays of different lengths as datasets 0000, 0001, ..."""
        self.write_arrays(group, {f"{number:04d}": np.asarray(curve, np.float64)
                                  for number, curve in enumerate(curves)})

    def write_arrays(self, group: str, arrays: Arrays) -> None:
        """Write arrays by name as they are, of any shapes."""
        target = self._file.require_group(group)
        for name, values in arrays.items():
            target[name] = values

    def write_separated(self, field: SeparatedField) -> None:
        """Write the products that a displacement is a sum of, in the image's axes whatever the mesh's are."""
        target = self._file.require_group(schema.SEPARATED)
        for name, values, unit, description in (
            ("nodes_x", field.along_x.nodes, "px", "nodes of the functions of x"),
            ("nodes_y", field.along_y.nodes, "px", "nodes of the functions of y, down"),
            ("amplitudes", field.amplitudes, "px", "RMS displacement of each mode (n_modes, 2), of u_x and of u_y"),
            ("x", field.x, "1", "functions of x at their nodes (n_modes, 2, n_x), of mean square 1"),
            ("y", field.y, "1", "functions of y at their nodes (n_modes, 2, n_y), of mean square 1"),
        ):
            target[name] = values
            target[name].attrs.update(unit=unit, description=description)

    def write_attributes(self, group: str, values: Mapping[str, Any]) -> None:
        """Write attributes of a group, which is made where there is none: texts, numbers or lists of them by name."""
        self._file.require_group(group).attrs.update(values)

    def write_status(self, failure: str) -> None:
        """Write whether the field converged, as attributes of the file.

        ``failure`` says why it is no result; it is empty where it converged.
        """
        self._file.attrs[schema.STATUS] = schema.NOT_CONVERGED if failure else schema.CONVERGED
        self._file.attrs[schema.FAILURE] = failure

    def _refuse_missing_pieces(self) -> None:
        """Raise where an announced piece has not been written."""
        missing = sorted(set(range(len(self._starts) - 1)) - self._written)
        if missing:
            raise ValueError(f"{self._path}: pieces {missing} were not written")

    def _oriented(self, values: NDArray[Any]) -> NDArray[Any]:
        """Vectors and tensors as the file has them."""
        return schema.flip_components(values) if self._flip_y else values

    def _create_fields(self, name: str, fields: Sequence[FieldSpec], length: int) -> None:
        """Make room for the fields of a group."""
        group = self._file.create_group(name)
        self._fields[name] = []
        for field in fields:
            created = _create(group, field.name, length, field.n_components, field.dtype)
            created.attrs.update(unit=field.unit, description=field.description, axes=field.axes)
            self._fields[name].append((field, created))

    def _write_fields(self, group: str, arrays: Arrays, start: int, length: int) -> None:
        """Write the fields of a group, rows from ``start`` on; they must be those announced."""
        names = {field.name for field, _ in self._fields[group]}
        if names != set(arrays):
            raise ValueError(f"{group}: fields {sorted(arrays)}, {sorted(names)} announced")
        for field, dataset in self._fields[group]:
            values = np.asarray(arrays[field.name])
            if field.n_components == schema.VECTOR:
                values = _three_components(values)
            expected = (length,) if field.n_components == 1 else (length, field.n_components)
            if values.shape != expected:
                raise ValueError(f"{group}/{field.name}: shape {values.shape}, {expected} announced")
            oriented = self._oriented(values) if field.axes == schema.AXES_OF_IMAGE else values
            _put(dataset, start, oriented)


def join_pieces(pieces: Sequence[Piece]) -> Piece:
    """Join pieces, at least one, one after the other, as the file holds them.

    In what comes back every piece still numbers its own points from 0.
    """
    if len(pieces) == 1:
        return pieces[0]

    def fields(all_of: Sequence[Arrays]) -> dict[str, NDArray[Any]]:
        return {name: np.concatenate([one[name] for one in all_of]) for name in all_of[0]}

    return Piece(np.concatenate([p.points for p in pieces]), np.concatenate([p.connectivity for p in pieces]),
                 np.concatenate([p.offsets for p in pieces]), np.concatenate([p.types for p in pieces]),
                 fields([p.point_data for p in pieces]), fields([p.cell_data for p in pieces]))


def _create(group: Any, name: str, length: int, n_components: int, dtype: DTypeLike) -> Any:
    """A dataset in one piece: half the file of a small mesh, and half the time, of one in chunks."""
    return group.create_dataset(name, (length,) if n_components == 1 else (length, n_components), dtype)


def _put(dataset: Any, start: int, values: NDArray[Any]) -> None:
    """Write values to the rows from ``start`` on, past h5py's indexing, which takes longer than to write some rows."""
    if not values.size:
        return
    rows = dataset.id.get_space()
    rows.select_hyperslab((start, *(0 for _ in values.shape[1:])), values.shape)
    dataset.id.write(h5py.h5s.create_simple(values.shape), rows, np.ascontiguousarray(values, dataset.dtype))


def _three_components(vectors: NDArray[Any]) -> NDArray[Any]:
    """Vectors with zeros for the components that they do not have, (n, 3)."""
    if vectors.ndim != 2 or vectors.shape[1] > 3:
        raise ValueError(f"vectors of shape {vectors.shape}, (n, dim) expected")
    return np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))


ROWS = 1 << 16
"""Points that are read at a time; a larger value takes memory."""


def write_physical_sidecar(result: Path, source: Any, files: NewFiles) -> None:
    """Write the file that shows a result in its length unit, NAME.physical.vtkhdf beside it.

    It holds the points alone: HDF5 external links lead to cells and fields in the result file, so both move together.
    Its field ``displacement`` is the result's ``displacement_physical``, and there is no other displacement: what is
    warped by it is the deformed specimen. ``source`` is the open content of the result file, with the size of a pixel
    in its units.
    """
    with new_hdf5(files.begin(schema.physical_path(result))) as (file, _):
        units = source[schema.UNITS].attrs
        schema.begin_file(file, flipped=schema.is_flipped(source))
        file.attrs[schema.SHOWS] = result.name
        group = schema.create_vtk_group(file, "UnstructuredGrid")
        for name in schema.TOPOLOGY:
            group[name] = _link(result, f"{schema.VTKHDF}/{name}")
        points, factor = source[schema.VTKHDF]["Points"], float(units["pixel_size"])
        scaled = group.create_dataset("Points", points.shape, points.dtype)
        for begin in range(0, len(points), ROWS):
            scaled[begin:begin + ROWS] = factor * points[begin:begin + ROWS]
        scaled.attrs["unit"] = units["length_unit"]
        if schema.STEPS in source:
            group["Steps"] = _link(result, schema.STEPS)
        _link_fields(result, source[schema.POINT_DATA], group.create_group("PointData"))
        _link_fields(result, source[schema.CELL_DATA], group.create_group("CellData"))


def _link_fields(result: Path, fields: Any, group: Any) -> None:
    """Link all fields but those displacements that do not fit the points."""
    for name in fields:
        if name in (schema.DISPLACEMENT, schema.DISPLACEMENT_MESH_UNITS):
            continue
        shown = schema.DISPLACEMENT if name == schema.DISPLACEMENT_PHYSICAL else name
        group[shown] = _link(result, f"{fields.name}/{name}")


def _link(result: Path, name: str) -> h5py.ExternalLink:
    return h5py.ExternalLink(result.name, name)


def write_sidecar(result: Path, camera: int, *, width: int, height: int, flip_y: bool, files: NewFiles) -> None:
    """Write the ImageData file that shows a residual image of a result, named by ``sidecar_path``.

    It holds no pixels: an HDF5 external link leads to the image in the result file, so both move together. ``camera``
    is 0 for the far camera, or the only one; then the near ones. ``width`` and ``height`` are those of the image,
    pixels. ``flip_y`` shows rows upwards (through VTKHDF's Direction, spacings being positive).
    """
    with new_hdf5(files.begin(schema.sidecar_path(result, camera))) as (file, _):
        schema.begin_file(file, flipped=flip_y)
        group = schema.create_vtk_group(file, "ImageData")
        group.attrs["WholeExtent"] = np.array([0, width - 1, 0, height - 1, 0, 0], np.int64)
        group.attrs["Origin"] = np.zeros(3)
        group.attrs["Spacing"] = np.ones(3)
        group.attrs["Direction"] = np.diag([1.0, -1.0 if flip_y else 1.0, 1.0]).ravel()
        data = group.create_group("PointData")
        data[schema.RESIDUAL] = _link(result, f"/{schema.residual_group(camera)}/{schema.RESIDUAL}")


def remove_result(result: Path) -> None:
    """Remove a result file and what stands beside it, as far as they are there."""
    result.unlink(missing_ok=True)
    _remove_company(result)


def move_result(result: Path, target: Path) -> None:
    """Give a result file and what stands beside it another name in its folder, in place of what has that name."""
    # First, and at once: whatever fails afterwards, neither is lost.
    result.replace(target)
    _remove_company(target)
    for camera, sidecar in enumerate(list(_list_sidecars(result))):
        _write_moved_sidecar(sidecar, target, camera)
        sidecar.unlink()
    physical = schema.physical_path(result)
    if physical.is_file():
        physical.unlink()
        if _has_length_unit(target):
            with open_hdf5(target) as source, replaced_together() as files:
                write_physical_sidecar(target, source, files)
    summary = schema.summary_path(result)
    if summary.is_file():
        summary.rename(schema.summary_path(target))
        _write_new_name(schema.summary_path(target), target)


def _remove_company(result: Path) -> None:
    for path in (schema.summary_path(result), schema.physical_path(result), *_list_sidecars(result)):
        path.unlink(missing_ok=True)


def _list_sidecars(result: Path) -> Iterator[Path]:
    for camera in count():
        path = schema.sidecar_path(result, camera)
        if not path.is_file():
            return
        yield path


def _write_moved_sidecar(sidecar: Path, target: Path, camera: int) -> None:
    """Write anew what leads to a residual image by the name of its file."""
    with open_hdf5(sidecar) as file:
        _, last_column, _, last_row, _, _ = file[schema.VTKHDF].attrs["WholeExtent"]
        flip_y = schema.is_flipped(file)
    with replaced_together() as files:
        write_sidecar(target, camera, width=int(last_column) + 1, height=int(last_row) + 1, flip_y=flip_y, files=files)


def _has_length_unit(result: Path) -> bool:
    """Whether a file holds displacements in a length unit; what is no result does not."""
    if not h5py.is_hdf5(result):
        return False
    with open_hdf5(result) as file:
        return schema.DISPLACEMENT_PHYSICAL in file.get(schema.POINT_DATA, ())


def _write_new_name(summary: Path, result: Path) -> None:
    try:
        content = json.loads(summary.read_text(encoding="utf-8"))
    except ValueError:
        # Whatever it is, it is not a summary that says a name.
        return
    if isinstance(content, dict) and "result_file" in content:
        write_json(summary, content | {"result_file": str(result)})
