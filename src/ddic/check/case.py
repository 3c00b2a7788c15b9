"""All that a case names, validated without solving; images in ``check/images.py``, ranks in ``check/ranks.py``."""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ddic.arrays import IntArray
from ddic.case.loader import LoadedCase, list_unused_keys, load_case_leniently
from ddic.case.methods import find_method, find_method_section
from ddic.case.named_files import list_cameras, list_deformed, list_named_files, list_times
from ddic.case.own_outputs import check_output
from ddic.case.schema import Case, IdentificationSection, RegularizationSection
from ddic.check.images import check_decodable, check_images, check_near_mapping, check_texture
from ddic.check.pattern import Pattern, find_pattern
from ddic.check.ranks import (
    check_most_ranks,
    check_number_of_subdomains,
    check_ranks,
    count_most_ranks,
    count_ranks_of_group,
)
from ddic.errors import InputError, Problems
from ddic.functionals.regularization import HalfAmplitudes
from ddic.images.source import ImageSource
from ddic.inputs.cameras import assign_cells, collect_measured_cells, open_cameras
from ddic.inputs.inputs import StartPoints, check_start_points, load_start_points, require_points_inside
from ddic.inputs.mesh_source import (
    NO_INNER_NODE,
    accept_mesh,
    build_mesh_anywhere,
    build_meshes,
    build_plain_grid,
    check_stiffness,
    check_wavelength_fits,
    is_plain_grid,
    read_case_simulation,
    share_cells,
)
from ddic.io.input_file import FileStamps
from ddic.io.result_reader import require_known_displacement
from ddic.io.series_reader import read_frame_or_last
from ddic.io.text_files import read_partition
from ddic.io.volume_file import hold_source
from ddic.mesh.cell_type import CELL_TYPES
from ddic.mesh.cut_mesh import cut_mesh
from ddic.mesh.grid import GridLines
from ddic.mesh.mesh import Mesh
from ddic.mesh.quality import measure_cell_size
from ddic.mesh.raster import rasterize
from ddic.mesh.repair import check_pixels
from ddic.mesh.topology import BOUNDARY, find_boundary_nodes, find_named_nodes, find_not_controlled_nodes
from ddic.partition.split import split_grid_by_blocks
from ddic.partition.ties import Tying
from ddic.problem.region_mesh import check_lines, describe_cut, describe_cut_off, list_discontinuities

MOST_BARE = 0.2
"""Share of the cells without texture up to which nothing is said in the last line."""


@dataclass(frozen=True)
class _CheckedMesh:
    """The whole mesh of a case, pixels, how near meshes are tied in it, and the pixels that measure each cell."""

    mesh: Mesh
    tying: Tying | None
    pixel_counts: IntArray


@dataclass(frozen=True)
class CheckReport:
    """What the inputs of a case are.

    Attributes
    ----------
    image_size : tuple of int
        Of the first camera's images along each axis, pixels.
    bits : int or None
        Bits per pixel of the images' integers; None for floats.
    n_nodes, n_cells, n_dofs : int
        Nodes and cells of the mesh, unknowns of the field.
    cell_counts, node_sets : dict of int
        Number of cells by name (T3, Q4), and of nodes by name of the set.
    pixels_min, pixels_mean : int, float
        Pixels of the cell that has fewest, and pixels per cell.
    n_controlled_dofs : int
        Unknowns that the equilibrium gap controls; 0 without regularization.
    output : Path
        The result file.
    discontinuities : str or None
        How much of the mesh they cut, where there are any.
    half_amplitudes : HalfAmplitudes or None
        Waves that the cut-off wavelength halves, pixels; None without one.
    most_ranks : int
        MPI ranks that can share the work, unless subdomains without texture join others.
    pattern : str
        What the reference image's pattern asks of the elements; empty where it was not looked at.
    n_bare_cells : int
        Cells that have hardly any texture.
    frames : tuple of (str, float)
        Names of the images of a series and their times; empty for a pair.
    """

    image_size: tuple[int, ...]
    bits: int | None
    n_nodes: int
    n_cells: int
    n_dofs: int
    cell_counts: dict[str, int]
    node_sets: dict[str, int]
    pixels_min: int
    pixels_mean: float
    n_controlled_dofs: int
    output: Path
    discontinuities: str | None
    half_amplitudes: HalfAmplitudes | None
    most_ranks: int
    pattern: str = ""
    n_bare_cells: int = 0
    frames: tuple[tuple[str, float], ...] = ()

    def list_lines(self) -> list[tuple[str, str]]:
        """List what ``ddic check`` prints: names and values."""
        images, of_images = ("images", "pixels") if len(self.image_size) == 2 else ("volumes", "voxels")
        kind = "floating point" if self.bits is None else f"{self.bits} bit"
        cells = ", ".join(f"{count} {name}" for name, count in self.cell_counts.items())
        sets = ", ".join(f"{name} ({count} nodes)" for name, count in self.node_sets.items())
        if self.half_amplitudes is not None:
            regularization = self.half_amplitudes.describe()
        else:
            regularization = "weight eta given" if self.n_controlled_dofs else "none"
        share = self.n_bare_cells / self.n_cells
        bare = (f"{self.n_bare_cells} of {self.n_cells} ({share:.0%}) have hardly any texture: move the region onto "
                "the pattern, or mask them")
        cut = [] if self.discontinuities is None else [("discontinuities", self.discontinuities)]
        return [
            (images, f"{' x '.join(map(str, self.image_size))} px, {kind}"),
            ("mesh", f"{self.n_nodes} nodes, {self.n_cells} cells ({cells})"),
            ("node sets", sets or "none"),
            *cut,
            ("unknowns", f"{self.n_dofs}, {self.n_controlled_dofs} of them mechanically controlled"),
            ("regularization", regularization),
            *([("pattern", self.pattern)] if self.pattern else []),
            *([("bare cells", bare)] if self.n_bare_cells else []),
            *((f"frame {number}", f"{name}, time {time:g}")
              for number, (name, time) in enumerate(self.frames, start=1)),
            (f"{of_images} per element", f"{self.pixels_min} at least, {self.pixels_mean:.1f} on average"),
            ("MPI ranks", f"{self.most_ranks} at most"),
            ("result", str(self.output)),
            ("verdict", "ready to run" if share <= MOST_BARE else f"ready to run, but {share:.0%} of the mesh is bare"),
        ]


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
    # It takes as long as to read the image, hence is not part of what a run checks.
    image = hold_source(loaded.case.imaging.reference, loaded.case.dim)
    return describe_pattern(report, loaded, build_checked_mesh(loaded, image), find_pattern(image))


def build_checked_mesh(loaded: LoadedCase, image: ImageSource) -> Mesh | GridLines:
    """Take the mesh of a case that was just checked, which is kept, or build it; pixels of its reference image.

    Of a rectangle of equal cells, which nobody builds as a whole, it is the lines.
    """
    kept = loaded.kept_mesh.take(loaded.case)
    if kept is not None:
        return kept[0]
    if find_method_section(loaded.case) is None and is_plain_grid(loaded.case):
        return build_plain_grid(loaded.case)
    mesh: Mesh = find_method(loaded.case).build_result_mesh(loaded.case, image.extent)
    return mesh


def describe_pattern(report: CheckReport, loaded: LoadedCase, mesh: Mesh | GridLines, pattern: Pattern) -> CheckReport:
    """Add to a report what the reference image's pattern asks of the mesh, and the frames of a series."""
    case = loaded.case
    if isinstance(mesh, GridLines):
        cell_size = mesh.cell_size
        rows = (GridLines((*mesh.lines[:-1], mesh.lines[-1][k:k + 2])) for k in range(mesh.n_along[-1]))
        n_bare = sum(int(pattern.find_bare(row.centroids).sum()) for row in rows)
    else:
        cell_size = measure_cell_size(mesh)
        n_bare = 0 if case.near else int(pattern.find_bare(mesh.centroids).sum())
    frames = tuple(zip((path.name for path in list_deformed(case.imaging)), list_times(case), strict=True))
    return replace(report, pattern=pattern.describe_elements(cell_size), n_bare_cells=n_bare,
                   frames=frames if loaded.is_series else ())


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
    if case.imaging.reference in list_deformed(case.imaging):
        frame = f"frame {list_deformed(case.imaging).index(case.imaging.reference) + 1}" if loaded.is_series else "this"
        warnings.warn(f"{loaded.path}: {case.imaging_name}.deformed: {frame} is the reference image itself; name "
                      "another one, or narrow the pattern, where that is not meant", UserWarning, stacklevel=2)
    names = [f"{loaded.path}: {case.imaging_name}", *(f"{loaded.path}: near[{k}]" for k in range(len(case.near)))]
    reference, *_ = [check_images(section, name, problems)
                     for section, name in zip(list_cameras(case), names, strict=True)]
    with problems.gathered(loaded.path):
        check_output(loaded)
    with problems.gathered():
        if case.start.from_result is not None:
            require_known_displacement(read_frame_or_last(case.start.from_result, case.start.frame, "start.frame =")[0])
    if case.simulation is not None:
        with problems.gathered(loaded.path):
            read_case_simulation(case)
    points = _check_start_points(loaded, reference, problems)
    report: CheckReport | None = find_method(case).check(loaded, reference, points, problems)
    with problems.gathered():
        if n_ranks is not None:
            n_ranks = count_ranks_of_group(loaded, n_ranks)
        check_ranks(loaded, 1 if n_ranks is None else n_ranks)
    if report is None or problems.lines or of_keys:
        raise InputError([*of_keys, *problems.lines])
    if n_ranks is not None:
        check_most_ranks(loaded, report.most_ranks, n_ranks)
    return report


def _check_start_points(loaded: LoadedCase, reference: ImageSource | None, problems: Problems) -> StartPoints | None:
    """The points that the case starts from; None where there are none, or they are wrong."""
    # A table of points is named by what is said of it.
    with problems.gathered(None if loaded.case.start.points is None else loaded.path):
        points = load_start_points(loaded.case.start, loaded.case.dim)
        if points is not None and reference is not None:
            check_start_points(points, reference.extent)
        return points
    return None


def check_on_mesh(loaded: LoadedCase, reference: ImageSource | None, points: StartPoints | None,
                  problems: Problems) -> CheckReport | None:
    """Check the mesh of a case and what refers to it; a mesh without problems is kept for the measurement."""
    case = loaded.case
    if reference is not None and is_plain_grid(case):
        return _check_on_grid(loaded, reference, points, problems)
    checked = _build_mesh(loaded, reference, problems)
    if checked is None:
        return None
    if points is not None:
        with problems.gathered(None if case.start.points is None else loaded.path):
            require_points_inside(points, checked.mesh)
    not_controlled = _check_mesh_uses(loaded, checked, problems)
    # What is wrong already may be why nothing is seen; near images may show what the far one does not.
    if reference is not None and not problems.lines and not case.near:
        with problems.gathered(loaded.path):
            check_texture(case, reference, checked.mesh, measure_cell_size(checked.mesh))
    if reference is None or problems.lines:
        return None
    loaded.kept_mesh.keep(case, checked.mesh, checked.tying)
    return _describe_inputs(case, reference, checked, not_controlled)


def _build_mesh(loaded: LoadedCase, reference: ImageSource | None, problems: Problems) -> _CheckedMesh | None:
    """The mesh and its pixels, or for its node sets' sake without pixels; None where it cannot be built at all."""
    case = loaded.case
    mesh, tying = None, None
    if reference is not None:
        with problems.gathered():
            mesh, tying = build_meshes(case, reference.extent)
    if mesh is None:
        # What is wrong with it, or with the image that it lies in, was said above.
        try:
            mesh = build_mesh_anywhere(case)
        except InputError:
            return None
    elif not (case.near and problems.lines):
        # What several cameras see of the mesh cannot be said without all of their images.
        with problems.gathered(loaded.path):
            return _CheckedMesh(mesh, tying, _count_pixels(case, mesh, tying))
    return _CheckedMesh(mesh, tying, np.ones(mesh.n_cells, np.int64))


def _count_pixels(case: Case, mesh: Mesh, tying: Tying | None) -> IntArray:
    """Number of pixels of each cell in the images of the camera that measures it, (n_cells,); raises InputError."""
    if not case.near:
        return rasterize(mesh).pixel_counts
    cameras = open_cameras(case, lambda path: hold_source(path, case.dim))
    for near in cameras[1:]:
        check_near_mapping(cameras[0], near)
    labels = assign_cells(cameras, mesh, tying)
    counts = np.zeros(mesh.n_cells, dtype=np.int64)
    for measured in collect_measured_cells(cameras, mesh, labels):
        counts[measured.cells] = rasterize(measured.seen).pixel_counts
    return counts


def check_mesh(loaded: LoadedCase, mesh: Mesh, n_ranks: int) -> None:
    """Check what a case with one camera asks of a mesh.

    Raises InputError with a line for each problem: cells without pixels, node sets, cut-off wavelength, partition,
    ranks.
    """
    problems = Problems()
    _check_mesh_uses(loaded, _CheckedMesh(mesh, None, rasterize(mesh).pixel_counts), problems)
    if problems.lines:
        raise InputError(problems.lines)
    check_most_ranks(loaded, count_most_ranks(loaded.case, mesh), n_ranks)


def _check_mesh_uses(loaded: LoadedCase, checked: _CheckedMesh, problems: Problems) -> IntArray:
    """Check what refers to the mesh, adding to ``problems``, and return the nodes that are not controlled, (n,)."""
    case = loaded.case
    mesh = checked.mesh
    with problems.gathered():
        check_pixels(mesh, checked.pixel_counts, case.mesh.name)
    not_controlled = np.zeros(0, np.int64)
    section = case.regularization
    if section is not None:
        edge = find_boundary_nodes(mesh)
        with problems.gathered(loaded.path):
            boundary = edge if checked.tying is None else checked.tying.boundary
            not_controlled = find_not_controlled_nodes(mesh, section.not_controlled, section.boxes, boundary)
        with problems.gathered(loaded.path):
            _check_wavelength(section.cut_off_wavelength, measure_cell_size(mesh), mesh.n_nodes - len(edge))
    with problems.gathered(loaded.path):
        check_stiffness(case, mesh)
    with problems.gathered(loaded.path):
        check_lines(case, mesh)
    if case.identification is not None:
        with problems.gathered(loaded.path):
            _check_identification(case, case.identification, mesh)
    with problems.gathered():
        if case.solver.partition_file is not None:
            read_partition(case.solver.partition_file, mesh.n_cells)
    with problems.gathered(loaded.path):
        check_number_of_subdomains(case.solver, mesh.n_cells)
    return not_controlled


def _check_identification(case: Case, section: IdentificationSection, mesh: Mesh) -> None:
    """Refuse, with an InputError, node sets that the mesh has not and materials of no cell."""
    named = [("loaded", name) for name in section.loaded if name != BOUNDARY]
    for key, name in [*named, *(("force.nodes", force.nodes) for force in section.force if force.nodes != BOUNDARY)]:
        try:
            find_named_nodes(mesh, name)
        except InputError as error:
            raise InputError([f"identification.{key}: {problem}" for problem in error.problems]) from error
    share_cells(case, mesh)


def _check_on_grid(loaded: LoadedCase, reference: ImageSource, points: StartPoints | None,
                   problems: Problems) -> CheckReport | None:
    """Check a rectangle of equal cells, of which nobody builds the whole mesh, and what refers to it."""
    case = loaded.case
    with problems.gathered():
        grid = build_plain_grid(case)
        outline, n_inner = grid.build_outline(), math.prod(len(line) - 2 for line in grid.lines)
        with problems.gathered():
            accept_mesh(outline, case.mesh.name, reference.extent, is_built_in=True)
        if points is not None:
            with problems.gathered(None if case.start.points is None else loaded.path):
                require_points_inside(points, outline)
        section, n_controlled = case.regularization, 0
        if section is not None:
            with problems.gathered(loaded.path):
                n_controlled = _count_controlled(grid, section)
            with problems.gathered(loaded.path):
                _check_wavelength(section.cut_off_wavelength, grid.cell_size, n_inner)
        with problems.gathered(loaded.path):
            check_number_of_subdomains(case.solver, grid.n_cells)
        if not problems.lines:
            with problems.gathered(loaded.path):
                check_texture(case, reference, outline, grid.cell_size)
        if not problems.lines:
            return _describe_grid(case, reference, grid, n_controlled)
    return None


def _count_controlled(grid: GridLines, section: RegularizationSection) -> int:
    """How many nodes of a grid are controlled; raises InputError as ``find_not_controlled_nodes`` does."""
    controlled = np.ones(tuple(map(len, grid.lines))[::-1], dtype=bool)
    empty = []
    for box in section.boxes:
        inside = [(line >= low) & (line <= high)
                  for line, low, high in zip(grid.lines, *np.reshape(box, (2, -1)), strict=True)]
        controlled[np.ix_(*inside[::-1])] = False
        if not all(along.any() for along in inside):
            empty.append(box)
    # A box without nodes of the grid has none of its corners either.
    find_not_controlled_nodes(grid.build_outline(), section.not_controlled, empty)
    sides = grid.sides
    for name in section.not_controlled:
        for side in sides if name == BOUNDARY else [name]:
            controlled.ravel()[sides[side]] = False
    return int(controlled.sum())


def _describe_grid(case: Case, reference: ImageSource, grid: GridLines, n_controlled: int) -> CheckReport:
    counts = grid.count_pixels()
    if case.solver.method == "monolithic":
        most_ranks = 1
    elif case.solver.blocks is not None:
        most_ranks = len(split_grid_by_blocks(grid, case.solver.blocks))
    else:
        most_ranks = case.solver.subdomains or grid.n_cells
    return CheckReport(
        image_size=reference.extent.sizes,
        bits=count_bits(reference),
        n_nodes=grid.n_nodes,
        n_cells=grid.n_cells,
        n_dofs=grid.dim * grid.n_nodes,
        cell_counts={grid.cell_type.name: grid.n_cells},
        node_sets={name: len(nodes) for name, nodes in grid.sides.items()},
        pixels_min=math.prod(int(along.min()) for along in counts),
        pixels_mean=math.prod(float(along.mean()) for along in counts),
        n_controlled_dofs=grid.dim * n_controlled,
        output=case.output.file,
        discontinuities=None,
        half_amplitudes=describe_cut_off(case.regularization, case.dim),
        most_ranks=most_ranks,
    )


def _check_wavelength(wavelength: float | None, cell_size: float, n_inner_nodes: int) -> None:
    """Refuse one that the mesh does not carry, and a mesh without inner nodes, which says nothing of any."""
    if wavelength is None:
        return
    if n_inner_nodes <= 0:
        raise InputError(f"regularization.cut_off_wavelength = {wavelength:g}: {NO_INNER_NODE}")
    check_wavelength_fits(wavelength, cell_size)


def _describe_inputs(case: Case, reference: ImageSource, checked: _CheckedMesh,
                     not_controlled: IntArray) -> CheckReport:
    """Describe inputs that were found fit; ``not_controlled``, (n,), are nodes that are not controlled."""
    mesh = checked.mesh
    n_unknown_nodes = mesh.n_nodes if checked.tying is None else checked.tying.n_unknown_nodes
    n_not_controlled = int((not_controlled < n_unknown_nodes).sum())
    n_controlled_nodes = 0 if case.regularization is None else n_unknown_nodes - n_not_controlled
    types, n_of_type = np.unique(mesh.types, return_counts=True)
    return CheckReport(
        image_size=reference.extent.sizes,
        bits=count_bits(reference),
        n_nodes=mesh.n_nodes,
        n_cells=mesh.n_cells,
        n_dofs=mesh.dim * n_unknown_nodes,
        cell_counts={CELL_TYPES[int(t)].name: int(n) for t, n in zip(types, n_of_type, strict=True)},
        node_sets={name: len(nodes) for name, nodes in mesh.node_sets.items() if len(nodes)},
        pixels_min=int(checked.pixel_counts.min()),
        pixels_mean=float(checked.pixel_counts.mean()),
        n_controlled_dofs=mesh.dim * n_controlled_nodes,
        output=case.output.file,
        discontinuities=_describe_discontinuities(case, mesh),
        half_amplitudes=describe_cut_off(case.regularization, case.dim),
        most_ranks=count_most_ranks(case, mesh),
    )


def _describe_discontinuities(case: Case, mesh: Mesh) -> str | None:
    lines = list_discontinuities(case).lines
    if lines:
        return describe_cut(cut_mesh(mesh, lines))
    return "1 line, to be found" if case.discontinuity else None


def count_bits(image: ImageSource) -> int | None:
    """Count the bits per pixel of an image; None for floats."""
    saturation = image.saturation
    return None if saturation is None else int(saturation).bit_length()
