"""All inputs of a case validated without solving, near-field images and where they lie among them."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from ddic.case.loader import LoadedCase
from ddic.case.schema import Case
from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import rasterize
from ddic.partition.ties import Tying
from ddic.problem.cameras import assign_cells, collect_cells, open_cameras, open_in_headers
from ddic.problem.check_case import check_case
from ddic.problem.check_near_mapping import check_near_mapping
from ddic.problem.check_report import CheckReport


def check_inputs(loaded: LoadedCase) -> CheckReport:
    """Validate a case.

    Parameters
    ----------
    loaded : LoadedCase
        The case file.

    Returns
    -------
    CheckReport
        What the inputs are.

    Raises
    ------
    InputError
        With the problems of all inputs, one line each.
    """
    case = loaded.case
    if not case.near:
        return check_case(loaded)
    return check_case(loaded, partial(_count_pixels_by_camera, case))


def _count_pixels_by_camera(case: Case, mesh: Mesh, tying: Tying | None) -> NDArray[np.int64]:
    """Number of pixels of each cell in the images of the camera that measures it, (n_cells,); raises InputError."""
    cameras = open_cameras(case, open_in_headers)
    far, *near_cameras = cameras
    for near in near_cameras:
        check_near_mapping(far, near)
    labels = assign_cells(cameras, mesh, tying)
    counts = np.zeros(mesh.n_cells, dtype=np.int64)
    for measured in collect_cells(cameras, mesh, labels):
        counts[measured.cells] = rasterize(measured.seen).pixel_counts
    return counts
