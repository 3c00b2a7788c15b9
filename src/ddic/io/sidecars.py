"""What stands beside a result file: the summary, and small VTKHDF files that show its images or units.

One shows the result in its length unit: points, and displacements that match them. ImageData files show the residual
images kept in the result file. A result and what stands beside it are moved or removed together.
"""

import json
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ddic.io import result_schema as schema
from ddic.io.damaged_result import open_hdf5
from ddic.io.hdf5_stream import new_hdf5
from ddic.io.replace_on_exit import NewFiles, replaced_together
from ddic.io.text_files import write_json

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
