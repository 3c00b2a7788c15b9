"""A small VTKHDF file that shows a result in its length unit: points, and displacements that match them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ddic.io import result_schema as schema
from ddic.io.hdf5_stream import new_hdf5
from ddic.io.replace_on_exit import NewFiles

ROWS = 1 << 16
"""Points that are read at a time; a larger value takes memory."""

SIZES = ("NumberOfPoints", "NumberOfCells", "NumberOfConnectivityIds", "Connectivity", "Offsets", "Types")


def write_physical_sidecar(result: Path, source: Any, files: NewFiles) -> Path:
    """Write the file that shows a result in its length unit.

    It holds the points alone: HDF5 external links lead to cells and fields in the result file, so both move together.
    Its field ``displacement`` is the result's ``displacement_physical``, and there is no other displacement: what is
    warped by it is the deformed specimen.

    Parameters
    ----------
    result : Path
        Name of the result file.
    source : h5py.File
        Its content, with the size of a pixel in its units.
    files : NewFiles
        With which it takes its name.

    Returns
    -------
    Path
        NAME.physical.vtkhdf beside the result.
    """
    path = schema.physical_path(result)
    with new_hdf5(files.begin(path)) as file:
        units, grid = source[schema.UNITS].attrs, source[schema.VTKHDF]
        file.attrs["ddic_schema"] = schema.SCHEMA_VERSION
        file.attrs["y_axis"] = source.attrs["y_axis"]
        file.attrs[schema.SHOWS] = result.name
        group = file.create_group(schema.VTKHDF)
        group.attrs["Version"] = np.array(schema.VTKHDF_VERSION, np.int64)
        group.attrs.create("Type", np.bytes_("UnstructuredGrid"))
        for name in SIZES:
            group[name] = _link(result, f"{schema.VTKHDF}/{name}")
        _scale_points(grid["Points"], group, float(units["pixel_size"]))
        group["Points"].attrs["unit"] = units["length_unit"]
        if schema.STEPS in source:
            group["Steps"] = _link(result, schema.STEPS)
        _link_fields(result, source[schema.POINT_DATA], group.create_group("PointData"))
        _link_fields(result, source[schema.CELL_DATA], group.create_group("CellData"))
    return path


def _scale_points(points: Any, group: Any, factor: float) -> None:
    """Copy points some rows at a time, times a factor."""
    scaled = group.create_dataset("Points", points.shape, points.dtype)
    for begin in range(0, len(points), ROWS):
        scaled[begin:begin + ROWS] = factor * points[begin:begin + ROWS]


def _link_fields(result: Path, fields: Any, group: Any) -> None:
    """Link all fields but those displacements that do not fit the points."""
    for name in fields:
        if name in (schema.DISPLACEMENT, schema.DISPLACEMENT_MESH_UNITS):
            continue
        shown = schema.DISPLACEMENT if name == schema.DISPLACEMENT_PHYSICAL else name
        group[shown] = _link(result, f"{fields.name}/{name}")


def _link(result: Path, name: str) -> h5py.ExternalLink:
    return h5py.ExternalLink(result.name, name)
