"""A small VTKHDF ImageData file that shows the residual image kept in a result file."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from ddic.io import result_schema as schema
from ddic.io.hdf5_stream import new_hdf5
from ddic.io.replace_on_exit import NewFiles


def write_sidecar(result: Path, camera: int = 0, *, width: int, height: int, flip_y: bool, files: NewFiles) -> Path:
    """Write the ImageData file that shows a residual image of a result.

    It holds no pixels: an HDF5 external link leads to the image in the result file, so both move together.

    Parameters
    ----------
    result : Path
        The result file.
    camera : int, optional
        0 for the far camera, or the only one; then the near ones.
    width, height : int
        Of the image, pixels.
    flip_y : bool
        Show rows upwards (through VTKHDF's Direction, spacings being positive).
    files : NewFiles
        With which it takes its name.

    Returns
    -------
    Path
        NAME.residual.vtkhdf or NAME.near_1.residual.vtkhdf beside the result.
    """
    path = schema.sidecar_path(result, camera)
    with new_hdf5(files.begin(path)) as file:
        file.attrs["ddic_schema"] = schema.SCHEMA_VERSION
        file.attrs["y_axis"] = "up" if flip_y else "down"
        group = file.create_group(schema.VTKHDF)
        group.attrs["Version"] = np.array(schema.VTKHDF_VERSION, np.int64)
        group.attrs.create("Type", np.bytes_("ImageData"))
        group.attrs["WholeExtent"] = np.array([0, width - 1, 0, height - 1, 0, 0], np.int64)
        group.attrs["Origin"] = np.zeros(3)
        group.attrs["Spacing"] = np.ones(3)
        group.attrs["Direction"] = np.diag([1.0, -1.0 if flip_y else 1.0, 1.0]).ravel()
        data = group.create_group("PointData")
        data[schema.RESIDUAL] = h5py.ExternalLink(result.name, f"/{schema.residual_group(camera)}/{schema.RESIDUAL}")
    return path
