"""What the reference images alone give: the mesh cut, its pixels and M; and a later frame in their place.

Subdomains without texture join a neighbour: by themselves their operators would be singular.
"""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from typing import TypeVar

import numpy as np
from scipy import sparse

from ddic.arrays import Array, BoolArray, IntArray
from ddic.case.schema import Case
from ddic.errors import InputError, list_first
from ddic.functionals.correlation import read_correlations, restrict_to_cells
from ddic.functionals.texture import Texture, find_blank_subdomains, measure_texture
from ddic.functionals.view import View
from ddic.images.threads import Threads
from ddic.inputs.cameras import Camera, Frame
from ddic.inputs.inputs import Inputs, UpdatedReference
from ddic.kinematics.camera import place_before_camera
from ddic.kinematics.kinematics import Kinematics
from ddic.mesh.cell_parts import find_offsets
from ddic.mesh.topology import find_adjacent_cells
from ddic.parallel.field import ByView
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team, require_held
from ddic.partition.split import find_connected_pieces, merge_blank
from ddic.partition.subdomain import Subdomain
from ddic.problem.choose_solver import choose_solver
from ddic.problem.grid_region import GridRegion, find_grid_region
from ddic.problem.region_mesh import Region, RegionMesh, build_region_mesh, finish_region, scatter_region, split_region
from ddic.solvers.petsc import describe_missing_packages

T = TypeVar("T")

V = TypeVar("V", bound=View)

Hessians = ByView[sparse.csr_matrix]
"""M of each view, on displacements of nodes in its image, (n_dofs, n_dofs)."""


@dataclass(frozen=True)
class ReferenceProblem:
    """Owned subdomains with their pixels and M, from the reference images alone.

    Attributes
    ----------
    inputs : Inputs
        What it was made from, with a case that says the linear step.
    region : Region
        What is known of the whole mesh.
    subdomains : list of Subdomain
        Those that this rank owns.
    views : ByView of View
        Their pixels, of cameras not yet weighted.
    hessians : ByView of (n_dofs, n_dofs) csr_matrix
        M of each view, on displacements of nodes in its image.
    n_pixels : int
        Pixels of all views of the whole region that the reference images do not exclude.
    notes : tuple of str
        What the user should know.
    """

    inputs: Inputs
    region: Region
    subdomains: list[Subdomain]
    views: ByView[View]
    hessians: Hessians
    n_pixels: int
    notes: tuple[str, ...]

    def convert_to_reference(self, q: Sequence[Array]) -> list[Array]:
        """Take unknowns since the first reference image from the one in use; free of communication.

        They stay the same, unless a later frame has taken the first image's place.
        """
        updated = self.inputs.updated
        if updated is None:
            return list(q)
        return [q_s - before for q_s, before in zip(q, updated.restrict(self.subdomains), strict=True)]


WholeMesh = RegionMesh | GridRegion | None
"""What a rank has of the whole mesh: rank 0 all of it and the others nothing, or all of them a grid's lines."""


Split = Callable[[], IntArray | None]
"""Finds the subdomain of each cell, (n_cells,), on rank 0 where that has the whole mesh; free of communication."""


def build_whole_mesh(team: Team, inputs: Inputs) -> WholeMesh:
    """Build the whole mesh; collective. Raises InputError on all ranks, where the mesh is refused."""
    grid = team.alike(lambda: find_grid_region(inputs))
    return team.build_on_root(lambda: build_region_mesh(inputs)) if grid is None else grid


def prepare_reference(team: Team, inputs: Inputs, whole: WholeMesh, clock: PhaseClock,
                      work_beside: Callable[[Split], tuple[IntArray | None, T]] | None = None,
                      ) -> tuple[ReferenceProblem, T | None]:
    """Choose how to solve, cut the mesh, read the reference images and assemble M; collective.

    ``work_beside`` has each rank do what it is given, by which rank 0 splits the mesh, and other work beside it;
    what this found is returned as well. No subdomain is blank where the others can hold it. Raises
    InputError on all ranks, where the mesh cannot be cut as asked, or leaves an image.
    """
    with clock.phase(Phase.START):
        held = whole
        inputs = choose_solver(team, inputs, lambda: require_held(None if held is None else held.measure_sizes()))
        whole = None if whole is None else replace(whole, inputs=inputs)

        def split() -> IntArray | None:
            return split_region(whole, team.size) if isinstance(whole, RegionMesh) else None

        parts, found = (team.together(split), None) if work_beside is None else work_beside(split)
    problem = _read_and_assemble(team, inputs, whole, parts, clock)
    case = inputs.case
    if case.solver.method != "dual" or case.regularization is None or problem.region.n_subdomains == 1:
        # Without regularization a blank part is singular whatever the partition, and the factorisation says where.
        return problem, found
    with clock.phase(Phase.ASSEMBLE):
        joined = _join_blank_subdomains(team, whole, problem)
    if joined is not None:
        region_mesh, parts, note = joined
        problem = _read_and_assemble(team, inputs, region_mesh, parts, clock, (note,))
    return problem, found


def _read_and_assemble(team: Team, inputs: Inputs, whole: WholeMesh, parts: IntArray | None, clock: PhaseClock,
                       notes: tuple[str, ...] = ()) -> ReferenceProblem:
    case = inputs.case
    with clock.phase(Phase.START):
        if isinstance(whole, GridRegion):
            subdomains, region = finish_region(team, inputs, *whole.cut(team))
        else:
            subdomains, region = scatter_region(team, inputs, whole, parts)
    with clock.phase(Phase.READ):
        views = team.together(lambda: read_reference_views(case, inputs.cameras, subdomains))
        n_pixels = team.sum(sum(view.n_pixels for view in views.flat))
    with clock.phase(Phase.ASSEMBLE):
        hessians = assemble_hessians(team, clock.note_each(views))
    notes = (*inputs.notes, *notes, *region.notes, *note_crowded_cores(team, case.solver.threads),
             *describe_missing_packages(case.solver.method))
    return ReferenceProblem(inputs, region, subdomains, views, hessians, n_pixels, notes)


def assemble_hessians(team: Team, views: Iterable[Sequence[View]]) -> Hessians:
    """Assemble M of all views of owned subdomains, gone through once; an error is raised on all ranks."""
    return team.together(lambda: ByView([view.assemble_hessian() for view in of_subdomain] for of_subdomain in views))


def _join_blank_subdomains(team: Team, whole: WholeMesh,
                           problem: ReferenceProblem) -> tuple[RegionMesh | None, IntArray | None, str] | None:
    """Merge subdomains, or loose pieces of them, without texture with neighbours of the same camera; collective.

    Gives the whole mesh and the new subdomain of each cell, (n_cells,), of which none is blank, both on rank 0, and
    what the user should know. None where no subdomain is blank, and where all are. Raises InputError on all ranks,
    where fewer subdomains than ranks are left.
    """
    pieces = team.together(lambda: list(_find_pieces(problem)))
    # Everybody holds the same list of the same numbers, hence comes to the same decision.
    described = team.gather_lists([(subdomain.index, subdomain.camera, texture) for subdomain, _, texture in pieces])
    owner, cameras = (np.array([piece[k] for piece in described]) for k in range(2))
    blank = _find_blank([texture for *_, texture in described], cameras)
    if not blank.any():
        return None
    # Pieces are joined by the facets that they share, over the whole mesh.
    if isinstance(whole, GridRegion):
        region_mesh = team.build_on_root(lambda: build_region_mesh(problem.inputs))
    else:
        region_mesh = whole
    cells = team.gather_to([cells for _, cells, _ in pieces])

    def merge() -> IntArray:
        mesh = require_held(region_mesh).mesh
        piece_of_cell = np.empty(mesh.n_cells, dtype=np.int64)
        for number, members in enumerate(c for of_rank in require_held(cells) for c in of_rank):
            piece_of_cell[members] = number
        parts = merge_blank(piece_of_cell, owner, _adjacency_within_cameras(require_held(region_mesh)), blank)
        n_before, n_left = len(np.unique(owner)), int(parts.max()) + 1
        if n_left < team.size:
            raise InputError(
                f"{n_before - n_left} of {n_before} subdomains hold no texture and join a neighbour, which leaves "
                f"{n_left} for {team.size} MPI ranks, but every rank needs at least one; start at most {n_left} ranks "
                "or ask for more subdomains (solver.subdomains)")
        return parts

    parts = team.build_on_root(merge)
    n_left = team.on_root(lambda: int(require_held(parts).max()) + 1)
    return region_mesh, parts, _describe(owner, blank, n_left)


def _find_pieces(problem: ReferenceProblem) -> Iterator[tuple[Subdomain, IntArray, Texture]]:
    """Connected pieces of owned subdomains: numbers of their cells in the whole mesh, and the own camera's texture."""
    degree = problem.inputs.case.correlation.spline_degree
    for subdomain, (own, *_), (hessian, *_) in zip(problem.subdomains, problem.views, problem.hessians, strict=True):
        labels = find_connected_pieces(find_adjacent_cells(subdomain.mesh))
        n_pieces = int(labels.max()) + 1
        if n_pieces == 1:
            yield subdomain, subdomain.cell_ids, measure_texture(own.correlation, hessian, degree)
            continue
        for k in range(n_pieces):
            cells = np.flatnonzero(labels == k)
            alone = restrict_to_cells(own.correlation, cells)
            yield subdomain, subdomain.cell_ids[cells], measure_texture(alone, alone.assemble_hessian(), degree)


def _find_blank(textures: Sequence[Texture], cameras: IntArray) -> BoolArray:
    """Which pieces are blank, (n_pieces,), by comparison with those of the same camera; none where all of one are."""
    blank = np.zeros(len(textures), dtype=bool)
    for camera in np.unique(cameras):
        places = np.flatnonzero(cameras == camera)
        found = find_blank_subdomains([textures[k] for k in places])
        # Where all are blank, there is no neighbour to join: the factorisation says where.
        blank[places] = found & ~found.all()
    return blank


def _adjacency_within_cameras(region_mesh: RegionMesh) -> tuple[IntArray, IntArray]:
    """Cells that share a facet, of one camera, as ``find_adjacent_cells`` gives them."""
    indptr, indices = find_adjacent_cells(region_mesh.mesh)
    cameras = region_mesh.cameras
    row = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
    same = cameras[row] == cameras[indices]
    counts = np.bincount(row[same], minlength=len(indptr) - 1)
    return find_offsets(counts), indices[same]


def _describe(owner: IntArray, blank: BoolArray, n_left: int) -> str:
    n_before = len(np.unique(owner))
    has_texture = np.isin(owner, owner[~blank])
    whole = np.unique(owner[~has_texture])
    n_loose = int((blank & has_texture).sum())
    lines = []
    if len(whole):
        lines.append(f"{len(whole)} of {n_before} subdomains without texture ({list_first(whole)}); "
                     f"{n_before - n_left} joined a neighbour, {n_left} are left")
    if n_loose:
        lines.append(f"{n_loose} loose pieces of subdomains without texture, joined with a neighbour")
    return "partition: " + "; ".join(lines)


def note_crowded_cores(team: Team, n_threads: int) -> tuple[str, ...]:
    """Write a line for the user where the ranks of a node have more threads than cores to run on; collective.

    One thread a rank is not remarked on: how many ranks there are is the user's choice.
    """
    if n_threads == 1:
        return ()
    with team.of_this_node() as node:
        cores = node.gather_lists([list_own_cores()])
    cores_of_node = frozenset[int]().union(*cores)
    nodes = team.gather_lists([(len(cores), len(cores_of_node))])
    n_ranks, n_cores = max(nodes, key=lambda found: found[0] / found[1])
    if n_ranks * n_threads <= n_cores:
        return ()
    return (f"threads: solver.threads = {n_threads} x {n_ranks} MPI ranks of a node = {n_ranks * n_threads} threads, "
            f"but these ranks may run on {n_cores} cores only: fewer threads are as fast",)


def list_own_cores() -> frozenset[int]:
    """List the cores that this process may run on: fewer than the node has where ranks are bound to cores."""
    # Not every system tells.
    if hasattr(os, "sched_getaffinity"):
        return frozenset(os.sched_getaffinity(0))
    return frozenset(range(os.cpu_count() or 1))


def update_reference(team: Team, problem: ReferenceProblem, frame: Frame, displacement: Array) -> Inputs:
    """Put a frame in the place of the reference image, and the mesh where the frame shows it; collective.

    ``problem`` is that of the reference image in use, of one camera, without discontinuities. The frame was measured:
    ``displacement``, (n_nodes, 2), is that of all nodes since the first reference image, finite, pixels. The mesh of
    the new inputs is refused where it has left the image.
    """
    inputs = problem.inputs
    first = _describe_first(team, problem) if inputs.updated is None else inputs.updated
    updated = replace(first, displacement=displacement)
    image = frame[0].image
    # What a case gives of the displacement is said of the first reference image.
    start = inputs.case.start.model_copy(update={"from_result": None, "frame": None, "from_points": None,
                                                 "points": None})
    camera = replace(inputs.cameras[0], reference=frame[0])
    return replace(inputs, case=inputs.case.model_copy(update={"start": start}), cameras=(camera,),
                   build_mesh=lambda: (updated.build_moved_mesh(image.extent), None),
                   updated=updated, notes=())


def _describe_first(team: Team, problem: ReferenceProblem) -> UpdatedReference:
    """The mesh and its parts in the first reference image; collective."""
    region = problem.region
    nodes = np.empty((region.n_nodes, problem.inputs.case.dim))
    parts = np.empty(region.n_cells, dtype=np.int64)
    for index, node_ids, of_nodes, cell_ids in team.gather_lists(
            [(s.index, s.node_ids, s.mesh.nodes, s.cell_ids) for s in problem.subdomains]):
        nodes[node_ids], parts[cell_ids] = of_nodes, index
    inputs = problem.inputs
    first_image = inputs.cameras[0].reference.image
    return UpdatedReference(nodes, np.zeros(nodes.shape), parts, first_image, inputs.build_mesh)


def read_reference_views(case: Case, cameras: Sequence[Camera], subdomains: Sequence[Subdomain]) -> ByView[View]:
    """Read the windows of the reference images that this rank's subdomains need; free of communication.

    The views of a subdomain are that of its own camera first, then of others that see it as well. All cameras weigh 1.
    Raises InputError where pixels of the mesh lie outside an image.
    """
    threads = Threads(case.solver.threads)
    views: list[list[View]] = [[] for _ in subdomains]
    for camera in cameras:
        seen = [k for k, s in enumerate(subdomains) if _is_seen_by(camera, cameras, s)]
        kinematics = [_kinematics_before(camera, cameras, subdomains[k]) for k in seen]
        groups = read_correlations([k.mesh for k in kinematics], camera.reference, case.correlation.spline_degree,
                                   threads)
        numbered = [(number, correlation) for number, group in enumerate(groups) for correlation in group]
        for place, of_subdomain, (number, correlation) in zip(seen, kinematics, numbered, strict=True):
            views[place].append(View(correlation, of_subdomain, camera.number, number))
    return ByView(sorted(of_subdomain, key=lambda view: view.camera != s.camera)
                  for s, of_subdomain in zip(subdomains, views, strict=True))


def _is_seen_by(camera: Camera, cameras: Sequence[Camera], subdomain: Subdomain) -> bool:
    return subdomain.camera == camera.number or (camera.number == 0 and cameras[subdomain.camera].use_far)


def _kinematics_before(camera: Camera, cameras: Sequence[Camera], subdomain: Subdomain) -> Kinematics:
    """From a subdomain's unknowns to displacements in a camera's pixels."""
    is_specimens_frame = camera.number == 0
    if is_specimens_frame and subdomain.motion is None:
        return subdomain.kinematics
    setup = camera.setup if camera.number == subdomain.camera else camera.setup.hold_still()
    numbers = None if subdomain.motion is None else subdomain.motion.numbers
    return place_before_camera(subdomain.kinematics, setup, numbers)


def project_hessians(views: ByView[V], hessians: Hessians) -> list[sparse.csr_matrix]:
    """Add up the cameras' M in the unknowns of each subdomain: M_s, (n_unknowns, n_unknowns)."""
    return add_matrices(views.map(View.project, hessians))


def add_matrices(matrices: ByView[sparse.csr_matrix]) -> list[sparse.csr_matrix]:
    """Add up the views of each owned subdomain, in their order."""
    return [reduce(add, of_views).tocsr() for of_views in matrices]


def hold_set_ups_still(subdomains: Sequence[Subdomain], views: ByView[V]) -> tuple[list[Subdomain], ByView[V]]:
    """Give what each subdomain's own camera alone sees, in a set-up that does not move: the field's unknowns only."""
    return [replace(s, motion=None) for s in subdomains], ByView([own.hold_still()] for own, *_ in views)


def weigh_cameras(views: ByView[V], weights: Sequence[float]) -> ByView[V]:
    """Give each camera its weight in the functional, of squared grey levels, no unit."""
    return views.map(lambda view: replace(view, weight=weights[view.camera]))
