"""All inputs of a case validated without solving, in one order, near-field images too, and for the ranks at hand."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ddic.arrays import IntArray
from ddic.case.loader import LoadedCase, list_unused_keys, load_case_leniently
from ddic.case.methods import find_method
from ddic.case.named_files import list_cameras, list_named_files
from ddic.case.own_outputs import check_output
from ddic.case.schema import Case
from ddic.check.images import check_decodable, check_images, check_texture
from ddic.check.mesh import CheckedMesh, check_mesh_uses, check_most_ranks
from ddic.check.near import check_near_mapping
from ddic.check.report import CheckReport, describe_inputs
from ddic.errors import InputError, Problems
from ddic.images.source import ImageSource
from ddic.inputs.cameras import assign_cells, collect_measured_cells, open_cameras
from ddic.inputs.mesh_source import build_mesh_anywhere, build_meshes
from ddic.inputs.start_points import StartPoints, check_start_points, load_start_points, require_points_inside
from ddic.io.image_file import open_image
from ddic.io.input_file import FileStamps
from ddic.io.result_reader import require_known_displacement
from ddic.io.series_reader import read_frame_or_last
from ddic.mesh.mesh import Mesh
from ddic.mesh.raster import rasterize
from ddic.partition.ties import Tying
from ddic.solvers.petsc import require_packages


def load_checked_case(path: Path, n_ranks: int, output: Path | None = None) -> LoadedCase:
    """Load a case file and check everything that it names, free of communication.

    ``output`` is the result file, None for the one that the case names. Raises InputError with all problems, one line
    each.
    """
    loaded, of_keys = _load_readable_keys(path)
    if output is not None:
        loaded = loaded.with_output(output)
    # Before they are checked: what changes afterwards was not.
    stamps = FileStamps.take(list_named_files(loaded.case, path.parent))
    check_case(loaded, n_ranks, of_keys)
    return replace(loaded, stamps=stamps)


def check_case_file(path: Path) -> CheckReport:
    """Check a case file and everything that it names. Raises InputError with all problems, one line each."""
    loaded, of_keys = _load_readable_keys(path)
    report = check_case(loaded, None, of_keys)
    problems = Problems()
    for section in list_cameras(loaded.case):
        check_decodable(section, problems)
    problems.require_none()
    return report


def _load_readable_keys(path: Path) -> tuple[LoadedCase, list[str]]:
    """The case as far as it can be read, and what is wrong with its keys; raises InputError where that leaves none."""
    loaded, of_keys = load_case_leniently(path)
    if loaded is None:
        raise InputError(of_keys)
    return loaded, of_keys


def check_case(loaded: LoadedCase, n_ranks: int | None = None, of_keys: Sequence[str] = ()) -> CheckReport:
    """Check everything that a case names, and whether it can run, free of communication.

    ``of_keys`` is what was found wrong before. Without ``n_ranks`` it is told of what would fail on any number of
    ranks. Raises InputError with all problems, one line each.
    """
    case, problems = loaded.case, Problems()
    for line in list_unused_keys(case):
        warnings.warn(f"{loaded.path}: {line}", UserWarning, stacklevel=2)
    reference, *_ = [check_images(section, problems) for section in list_cameras(case)]
    with problems.gathered(loaded.path):
        check_output(loaded)
    with problems.gathered():
        if case.start.from_result is not None:
            require_known_displacement(read_frame_or_last(case.start.from_result, case.start.frame, "start.frame =")[0])
    points = _check_start_points(loaded, reference, problems)
    report: CheckReport | None = find_method(case).check(loaded, reference, points, problems)
    with problems.gathered():
        check_ranks(loaded, 1 if n_ranks is None else n_ranks)
    if report is None or problems.lines or of_keys:
        raise InputError([*of_keys, *problems.lines])
    if n_ranks is not None:
        check_most_ranks(loaded, report.most_ranks, n_ranks)
    return report


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


def check_on_mesh(loaded: LoadedCase, reference: ImageSource | None, points: StartPoints | None,
                  problems: Problems) -> CheckReport | None:
    """Check the mesh of a case and what refers to it; a mesh without problems is kept for the measurement."""
    case = loaded.case
    checked = _build_mesh(loaded, reference, problems)
    if checked is None:
        return None
    with problems.gathered(_case_of_points(loaded)):
        if points is not None:
            require_points_inside(points, checked.mesh)
    not_controlled = check_mesh_uses(loaded, checked, problems)
    # What is wrong already may be why nothing is seen; near images may show what the far one does not.
    if reference is not None and not problems.lines and not case.near:
        with problems.gathered(loaded.path):
            check_texture(case, reference, checked.mesh)
    if reference is None or problems.lines:
        return None
    loaded.kept_mesh.keep(case, checked.mesh, checked.tying)
    return describe_inputs(case, reference, checked, not_controlled)


def _build_mesh(loaded: LoadedCase, reference: ImageSource | None, problems: Problems) -> CheckedMesh | None:
    """The mesh and its pixels, or for its node sets' sake without pixels; None where it cannot be built at all."""
    case = loaded.case
    mesh, tying = None, None
    if reference is not None:
        with problems.gathered():
            mesh, tying = build_meshes(case, reference.width, reference.height)
    if mesh is None:
        # What is wrong with it, or with the image that it lies in, was said above.
        try:
            mesh = build_mesh_anywhere(case)
        except InputError:
            return None
    elif not (case.near and problems.lines):
        # What several cameras see of the mesh cannot be said without all of their images.
        with problems.gathered(loaded.path):
            return CheckedMesh(mesh, tying, _count_pixels(case, mesh, tying))
    return CheckedMesh(mesh, tying, np.ones(mesh.n_cells, np.int64))


def _count_pixels(case: Case, mesh: Mesh, tying: Tying | None) -> IntArray:
    """Number of pixels of each cell in the images of the camera that measures it, (n_cells,); raises InputError."""
    if not case.near:
        return rasterize(mesh).pixel_counts
    cameras = open_cameras(case, open_image)
    far, *near_cameras = cameras
    for near in near_cameras:
        check_near_mapping(far, near)
    labels = assign_cells(cameras, mesh, tying)
    counts = np.zeros(mesh.n_cells, dtype=np.int64)
    for measured in collect_measured_cells(cameras, mesh, labels):
        counts[measured.cells] = rasterize(measured.seen).pixel_counts
    return counts


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
