"""All inputs of a case validated without solving."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ddic.case.loader import LoadedCase
from ddic.errors import InputError
from ddic.images.source import ImageSource
from ddic.io.result_reader import read_result
from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import rasterize
from ddic.partition.ties import Tying
from ddic.problem.check_images import check_images
from ddic.problem.check_mesh_uses import CheckedMesh, check_mesh_uses
from ddic.problem.check_output import check_output
from ddic.problem.check_report import CheckReport, describe_inputs
from ddic.problem.check_separated import check_separated_case
from ddic.problem.gather_problems import Problems
from ddic.problem.mesh_source import build_meshes

PixelCounter = Callable[[Mesh, Tying | None], NDArray[np.int64]]
"""Gives the number of pixels of each cell of a mesh, (n_cells,); raises InputError where an image is unfit."""


def check_case(loaded: LoadedCase, count_pixels: PixelCounter | None = None) -> CheckReport:
    """Read and validate the images, masks, mesh, node sets, partition, start and output of a case.

    Parameters
    ----------
    loaded : LoadedCase
        The case file.
    count_pixels : callable, optional
        Gives the number of pixels of each cell; by default those of the first camera's images.

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
    problems = Problems()
    reference = check_images(case.images, problems)
    for near in case.near:
        check_images(near, problems)
    with problems.gathered(loaded.path):
        check_output(loaded)
    with problems.gathered():
        if case.start.from_result is not None:
            read_result(case.start.from_result)
    if reference is None:
        raise InputError(problems.lines)
    if case.pgd is not None:
        return check_separated_case(loaded, reference, problems)
    checked = _check_mesh(loaded, reference, count_pixels or _count_pixels, problems)
    not_controlled = check_mesh_uses(loaded, checked, problems)
    problems.require_none()
    return describe_inputs(case, reference, checked, not_controlled)


def _check_mesh(loaded: LoadedCase, reference: ImageSource, count_pixels: PixelCounter,
                problems: Problems) -> CheckedMesh:
    """The mesh and its pixels; where there is none, raises InputError with this and all earlier problems."""
    try:
        mesh, tying = build_meshes(loaded.case, reference.width, reference.height)
    except InputError as error:
        problems.add(error)
        raise InputError(problems.lines) from error
    # What several cameras see of the mesh cannot be said without all of their images.
    if loaded.case.near:
        problems.require_none()
    try:
        return CheckedMesh(mesh, tying, count_pixels(mesh, tying))
    except InputError as error:
        problems.add(error, loaded.path)
        raise InputError(problems.lines) from error


def _count_pixels(mesh: Mesh, _: Tying | None) -> NDArray[np.int64]:
    """Pixels of each cell in images that show the mesh as it is."""
    return rasterize(mesh).pixel_counts
