"""Writes the result file piece by piece, in the VTKHDF layout (UnstructuredGrid, one piece per subdomain).

The summary and small VTKHDF files stand beside it, and are moved or removed with it.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import h5py
import numpy as np
from numpy.typing import NDArray

from ddic.arrays import Array, IntArray
from ddic.io import result_schema as schema
from ddic.io.hdf5_file import Arrays, open_hdf5
from ddic.io.image_chunks import ChunkGrid
from ddic.io.new_hdf5 import Block, new_hdf5
from ddic.io.replace_on_exit import NewFiles, replaced_together
from ddic.io.result_pieces import (
    NOTHING,
    Piece,
    PieceCounts,
    PieceLayout,
    add_counts,
    count_piece,
    create_mesh,
    join_pieces,
)
from ddic.io.result_reader import Result, read_open_file
from ddic.io.result_schema import FieldSpec
from ddic.io.text_files import write_json
from ddic.separated.field import SeparatedField


class ResultWriter:
    """A result file under construction; use it in a ``with`` statement.

    What a measurement is made of is up to it: a mesh with fields, images, tables, curves, attributes. For fields and
    images it makes room, which others fill by ``write_block``, or straight in the ``begun`` file.

    Parameters
    ----------
    path : Path or None
        Final name, taken only when the block ends without an exception; None for a file in memory, which ``read_back``
        reads.
    flip_y : bool
        Write y upwards.
    files : NewFiles, optional
        With which the file and what stands beside it take their names; by default they do so by themselves.
    """

    def __init__(self, path: Path | None, *, flip_y: bool = False, files: NewFiles | None = None) -> None:
        self.path = path
        self.begun: Path | None = None
        self._flip_y = flip_y
        self._files = files
        self._grids: list[ChunkGrid] = []

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
            files = self._files or stack.enter_context(replaced_together())
            if self.path is not None:
                self.begun = files.begin(self.path)
            self._new = stack.enter_context(new_hdf5(self.begun))
            self._file = self._new.file
            schema.begin_file(self._file, flipped=self._flip_y)
            yield
            if self.path is not None:
                self._write_company(self.path, files)

    def _write_company(self, path: Path, files: NewFiles) -> None:
        """Write what shows the residual images and the length unit."""
        if not self._grids:
            # One of an earlier run would point to an image that is no longer there.
            files.remove_old(schema.sidecar_path(path))
        for camera, grid in enumerate(self._grids):
            _write_sidecar(path, camera, grid.extent.sizes, flip_y=self._flip_y, files=files)
        if schema.UNITS in self._file and schema.DISPLACEMENT_PHYSICAL in self._file.get(schema.POINT_DATA, ()):
            write_physical_sidecar(path, self._file, files)
        else:
            files.remove_old(schema.physical_path(path))

    def read_back(self) -> Result:
        """Read what was written, with the residual image, to memory while the file is open."""
        return read_open_file(Path(), self._file)

    def read_image(self) -> bytes:
        """Read the content of a file in memory, as it would be on the disk."""
        return self._new.get_content()

    def create_mesh(self, total: PieceCounts, point_fields: Sequence[FieldSpec],
                    cell_fields: Sequence[FieldSpec]) -> PieceLayout:
        """Make room for a mesh in pieces, ``total`` of all, and for the fields that every piece brings."""
        layout = create_mesh(self._new, total, point_fields, cell_fields, flip_y=self._flip_y)
        self._new.require_written()
        return layout

    def write_pieces(self, pieces: Sequence[Piece], point_fields: Sequence[FieldSpec],
                     cell_fields: Sequence[FieldSpec]) -> None:
        """Write a mesh with its fields; raises ValueError where pieces do not have the fields announced."""
        counts = [count_piece(piece) for piece in pieces]
        layout = self.create_mesh(add_counts(counts), point_fields, cell_fields)
        for block in layout.place(NOTHING, counts, join_pieces(pieces)):
            self.write_block(block)

    def create_residual_image(self, grid: ChunkGrid, numbers: IntArray, n_bytes: IntArray) -> IntArray:
        """Make room for some chunks of the next camera's residual image, which is NaN where there is none.

        ``numbers`` of chunks and ``n_bytes`` of each, as ``pack_chunk`` makes it, are (n,); so are the places in the
        file that are returned.
        """
        group = schema.residual_group(len(self._grids))
        data = self._file.create_dataset(f"{group}/{schema.RESIDUAL}", grid.extent.shape, "<f4",
                                         chunks=grid.shape, compression="gzip", compression_opts=1,
                                         shuffle=True, fillvalue=np.nan)
        data.attrs.update(unit="grey level", description="f(x) - g(x + u), NaN where not correlated; rows go down")
        self._file[group].attrs["origin"] = np.zeros(len(grid.shape))
        self._grids.append(grid)
        places = np.empty(len(numbers), np.int64)
        # In the order of chunks, whoever has them.
        for k in np.argsort(numbers):
            window = grid.locate_chunk(int(numbers[k]))
            places[k] = self._new.create_chunk(data, window.lower[::-1], int(n_bytes[k]))
        self._new.require_written()
        return places

    def write_block(self, block: Block) -> None:
        """Write a block of the mesh, of its fields or of a residual image; raises OSError where the disk refuses it."""
        self._new.write(block)

    def write_table(self, group: str, columns: Mapping[str, Sequence[Any] | NDArray[Any]]) -> None:
        """Write a table, a dataset per column of numbers or texts; raises ValueError if their lengths differ."""
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

    def write_status(self, failure: str, verdict: schema.Verdict) -> None:
        """Write, as attributes of the file, why the field did not converge, empty where it did, and the verdict."""
        self._file.attrs[schema.STATUS] = schema.NOT_CONVERGED if failure else schema.CONVERGED
        self._file.attrs[schema.FAILURE] = failure
        self._file.attrs[schema.VERDICT] = verdict.word
        self._file.attrs[schema.REASONS] = "\n".join(verdict.reasons)


ROWS = 1 << 16
"""Points that are read at a time; a larger value takes memory."""


def write_physical_sidecar(result: Path, source: Any, files: NewFiles) -> None:
    """Write the file that shows a result in its length unit, NAME.physical.vtkhdf beside it.

    It holds the points alone: HDF5 external links lead to cells and fields in the result file, so both move together.
    Its field ``displacement`` is the result's ``displacement_physical``, and there is no other displacement: what is
    warped by it is the deformed specimen. ``source`` is the open content of the result file, with the size of a pixel
    in its units.
    """
    with new_hdf5(files.begin(schema.physical_path(result))) as new:
        file = new.file
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


def _write_sidecar(result: Path, camera: int, sizes: Sequence[int], *, flip_y: bool, files: NewFiles) -> None:
    """Write the ImageData file that shows a residual image of a result, named by ``sidecar_path``.

    It holds no pixels: an HDF5 external link leads to the image in the result file, so both move together. ``camera``
    is 0 for the far camera, or the only one; then the near ones. ``sizes`` are the image's along each axis, pixels.
    ``flip_y`` shows rows upwards (through VTKHDF's Direction, spacings being positive).
    """
    with new_hdf5(files.begin(schema.sidecar_path(result, camera))) as new:
        file = new.file
        schema.begin_file(file, flipped=flip_y)
        group = schema.create_vtk_group(file, "ImageData")
        last = np.zeros(3, np.int64)
        last[:len(sizes)] = np.subtract(sizes, 1)
        group.attrs["WholeExtent"] = np.stack([np.zeros(3, np.int64), last], axis=1).ravel()
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
        last = file[schema.VTKHDF].attrs["WholeExtent"][1::2].tolist()
        flip_y = schema.is_flipped(file)
    # A plane image has the place 0 alone along the third axis.
    sizes = [place + 1 for place in last if place > 0]
    with replaced_together() as files:
        _write_sidecar(target, camera, sizes, flip_y=flip_y, files=files)


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
