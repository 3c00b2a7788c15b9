"""All inputs of a case validated without solving, near-field images too, and for the ranks that were started."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ddic.case.loader import LoadedCase, list_unused_keys, load_case_leniently
from ddic.case.methods import find_method
from ddic.case.schema import Case
from ddic.check.images import check_decodable, check_images, check_texture
from ddic.check.mesh import CheckedMesh, check_mesh_uses, check_most_ranks
from ddic.check.near import check_near_mapping
from ddic.check.output import check_output, list_named_files
from ddic.check.report import CheckReport, describe_inputs
from ddic.errors import InputError
from ddic.images.source import ImageSource
from ddic.inputs.cameras import assign_cells, collect_cells, open_cameras, open_in_headers
from ddic.inputs.inputs import Problems
from ddic.inputs.mesh_source import build_mesh_anywhere, build_meshes
from ddic.inputs.start_points import StartPoints, check_start_points, load_start_points, require_points_inside
from ddic.io.damaged_result import require_known_displacement
from ddic.io.input_file import FileStamps
from ddic.io.series_reader import read_frame_or_last
from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import rasterize
from ddic.partition.ties import Tying
from ddic.solvers.petsc import require_packages

PixelCounter = Callable[[Mesh, Tying | None], NDArray[np.int64]]
"""Gives the number of pixels of each cell of a mesh, (n_cells,); raises InputError where an image is unfit."""


def check_ranks(loaded: LoadedCase, n_ranks: int) -> None:
    """Refuse, with an InputError, a number of ranks on which the case's method cannot measure it."""
    find_method(loaded.case).check_ranks(loaded, n_ranks)


def check_ranks_of_subdomains(loaded: LoadedCase, n_ranks: int) -> None:
    """Refuse more ranks than a case has subdomains, and solvers that PETSc has not on so many.

    Raises InputError where a rank would have no subdomain, or PETSc lacks what the solver needs.
    """
    solver = loaded.case.solver
    require_packages(str(loaded.path), solver.method, solver.local_inverse, n_ranks)
    if solver.method == "monolithic":
        if n_ranks > 1:
            raise InputError(f'{loaded.path}: solver.method = "monolithic" runs on one rank, {n_ranks} were started; '
                             'start one rank or use "dual"')
        return
    largest = solver.subdomains if solver.blocks is None else solver.blocks[0] * solver.blocks[1]
    if largest is not None and n_ranks > largest:
        key = "solver.subdomains" if solver.blocks is None else "solver.blocks"
        raise InputError(f"{loaded.path}: {key}: {largest} subdomains for {n_ranks} MPI ranks, but every rank needs at "
                         f"least one; start at most {largest} ranks or ask for more subdomains")


def load_checked_case(path: Path, n_ranks: int, output: Path | None = None) -> LoadedCase:
    """Load a case file and check everything that it names, free of communication.

    ``output`` is the result file, None for the one that the case names. Raises InputError with all problems, one line
    each.
    """
    loaded, of_keys = _load_readable_keys(path)
    if output is not None:
        loaded = loaded.with_output(output)
    # Before they are checked: what changes afterwards was not.
    stamps = FileStamps.take(list_named_files(loaded.case))
    _check(loaded, of_keys, n_ranks)
    return replace(loaded, stamps=stamps)


def check_loaded_case(loaded: LoadedCase, n_ranks: int) -> None:
    """Check everything that a case names, and whether it can run, free of communication.

    Raises InputError with all problems, one line each.
    """
    _check(loaded, (), n_ranks)


def check_case_file(path: Path) -> CheckReport:
    """Check a case file and everything that it names. Raises InputError with all problems, one line each."""
    loaded, of_keys = _load_readable_keys(path)
    report = _check(loaded, of_keys, None)
    problems = Problems()
    check_decodable(loaded.case.images, problems)
    for near in loaded.case.near:
        check_decodable(near, problems)
    problems.require_none()
    return report


def _load_readable_keys(path: Path) -> tuple[LoadedCase, list[str]]:
    """The case as far as it can be read, and what is wrong with its keys; raises InputError where that leaves none."""
    loaded, of_keys = load_case_leniently(path)
    if loaded is None:
        raise InputError(of_keys)
    return loaded, of_keys


def _check(loaded: LoadedCase, of_keys: Sequence[str], n_ranks: int | None) -> CheckReport:
    problems, report = Problems(), None
    problems.lines += of_keys
    with problems.gathered():
        report = check_case(loaded)
    with problems.gathered():
        # Who only checks is told of what would fail on any number of ranks.
        check_ranks(loaded, 1 if n_ranks is None else n_ranks)
    problems.require_none()
    if report is None:
        raise TypeError("inputs without problems have a report")
    if n_ranks is not None:
        check_most_ranks(loaded, report.most_ranks, n_ranks)
    return report


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


def check_case(loaded: LoadedCase) -> CheckReport:
    """Read and validate the images, masks, start and output of a case, and what its method asks for.

    Raises InputError with the problems of all inputs, one line each.
    """
    case = loaded.case
    problems = Problems()
    for line in list_unused_keys(case):
        warnings.warn(f"{loaded.path}: {line}", UserWarning, stacklevel=2)
    reference = check_images(case.images, problems)
    for near in case.near:
        check_images(near, problems)
    with problems.gathered(loaded.path):
        check_output(loaded)
    with problems.gathered():
        if case.start.from_result is not None:
            require_known_displacement(read_frame_or_last(case.start.from_result, case.start.frame, "start.frame =")[0])
    points = _check_start_points(loaded, reference, problems)
    report: CheckReport = find_method(case).check(loaded, reference, points, problems)
    return report


def check_on_mesh(loaded: LoadedCase, reference: ImageSource | None, points: StartPoints | None,
                  problems: Problems) -> CheckReport:
    """Read and validate the mesh, node sets, partition and texture of a case, after its images.

    Raises InputError with the problems of all inputs, one line each, those that were found before among them.
    """
    case = loaded.case
    count_pixels = partial(_count_pixels_by_camera, case) if case.near else _count_pixels
    checked = _check_mesh(loaded, reference, count_pixels, problems)
    with problems.gathered(_case_of_points(loaded)):
        if points is not None:
            require_points_inside(points, checked.mesh)
    not_controlled = check_mesh_uses(loaded, checked, problems)
    # What is wrong already may be why nothing is seen; near images may show what the far one does not.
    if reference is not None and not problems.lines and not case.near:
        with problems.gathered(loaded.path):
            check_texture(case, reference, checked.mesh)
    if reference is None or problems.lines:
        raise InputError(problems.lines)
    loaded.kept_mesh.keep(case, checked.mesh, checked.tying)
    return describe_inputs(case, reference, checked, not_controlled)


def _check_start_points(loaded: LoadedCase, reference: ImageSource | None, problems: Problems) -> StartPoints | None:
    """The points that the case starts from; None where there are none, or they are wrong."""
    with problems.gathered(_case_of_points(loaded)):
        points = load_start_points(loaded.case.start)
        if points is not None and reference is not None:
            check_start_points(points, reference.width, reference.height)
        return points
    return None


def _case_of_points(loaded: LoadedCase) -> Path | None:
    """The case file where it holds the points itself; a table of points is named by what is said of it."""
    return None if loaded.case.start.points is None else loaded.path


def _check_mesh(loaded: LoadedCase, reference: ImageSource | None, count_pixels: PixelCounter,
                problems: Problems) -> CheckedMesh:
    """The mesh and its pixels; where there is none at all, raises InputError with this and all earlier problems."""
    case = loaded.case
    try:
        if reference is None:
            return _without_pixels(build_mesh_anywhere(case))
        mesh, tying = build_meshes(case, reference.width, reference.height)
    except InputError as error:
        if reference is not None:
            problems.add(error)
        return _build_unplaced(case, problems)
    # What several cameras see of the mesh cannot be said without all of their images.
    if case.near and problems.lines:
        return _without_pixels(mesh, tying)
    try:
        return CheckedMesh(mesh, tying, count_pixels(mesh, tying))
    except InputError as error:
        problems.add(error, loaded.path)
        return _without_pixels(mesh, tying)


def _build_unplaced(case: Case, problems: Problems) -> CheckedMesh:
    """The mesh outside the image, for its node sets' sake."""
    try:
        return _without_pixels(build_mesh_anywhere(case))
    except InputError as error:
        # What is wrong with it was said above, unless no image was there to build it for.
        if not problems.lines:
            problems.add(error)
        raise InputError(problems.lines) from error


def _without_pixels(mesh: Mesh, tying: Tying | None = None) -> CheckedMesh:
    """A mesh of which nothing is said by pixels."""
    return CheckedMesh(mesh, tying, np.ones(mesh.n_cells, np.int64))


def _count_pixels(mesh: Mesh, _: Tying | None) -> NDArray[np.int64]:
    """Pixels of each cell in images that show the mesh as it is."""
    return rasterize(mesh).pixel_counts
