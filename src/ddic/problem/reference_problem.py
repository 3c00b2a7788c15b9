"""What the reference images alone give: the mesh cut, its pixels and M; and a later frame in their place.

Subdomains without texture join a neighbour: by themselves their operators would be singular.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.errors import InputError, list_first
from ddic.functionals.correlation import restrict_to_cells
from ddic.functionals.texture import Texture, find_blank_subdomains, measure_texture
from ddic.inputs.cameras import Frame
from ddic.inputs.inputs import Inputs, UpdatedReference
from ddic.mesh.topology import find_adjacent_cells
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.team import Team, require_held
from ddic.partition.split import find_connected_pieces, merge_blank
from ddic.partition.subdomain import Subdomain
from ddic.problem.assembly import Hessians, assemble_hessians
from ddic.problem.choose_solver import choose_solver
from ddic.problem.region_mesh import Region, RegionMesh, build_region_mesh, scatter_region, split_region
from ddic.problem.views import ReferenceViews, read_reference_views
from ddic.solvers.petsc import describe_missing_packages

Array = NDArray[np.float64]

T = TypeVar("T")


@dataclass(frozen=True)
class ReferenceProblem:
    """Owned subdomains with their pixels and M, from the reference images alone.

    Attributes
    ----------
    inputs : Inputs
        What it was made from, with a case that says the linear step.
    region : Region
        What is known of the whole mesh.
    references : list of ReferenceViews
        Owned subdomains, cameras not yet weighted.
    hessians : list of list of (n_dofs, n_dofs) csr_matrix
        M of each view, on displacements of nodes in its image.
    n_pixels : int
        Pixels of all views of the whole region that the reference images do not exclude.
    notes : tuple of str
        What the user should know.
    """

    inputs: Inputs
    region: Region
    references: list[ReferenceViews]
    hessians: list[Hessians]
    n_pixels: int
    notes: tuple[str, ...]

    @property
    def subdomains(self) -> list[Subdomain]:
        """Owned subdomains."""
        return [reference.subdomain for reference in self.references]

    def convert_to_reference(self, q: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
        """Take unknowns since the first reference image from the one in use; free of communication.

        They stay the same, unless a later frame has taken the first image's place.
        """
        updated = self.inputs.updated
        if updated is None:
            return list(q)
        return [q_s - before for q_s, before in zip(q, updated.restrict(self.subdomains), strict=True)]


def build_whole_mesh(team: Team, inputs: Inputs) -> RegionMesh | None:
    """Build the whole mesh on rank 0; collective. Raises InputError on all ranks, where the mesh is refused."""
    return team.build_on_root(lambda: build_region_mesh(inputs))


def prepare_reference(team: Team, inputs: Inputs, region_mesh: RegionMesh | None, clock: PhaseClock,
                      meanwhile: Callable[[], T]) -> tuple[ReferenceProblem, T]:
    """Choose how to solve, cut the mesh, read the reference images and assemble M; collective.

    The whole mesh is on rank 0. ``meanwhile`` is work free of communication that other ranks do while rank 0 splits it;
    what this found on this rank is returned as well. No subdomain is blank where the others can hold it. Raises
    InputError on all ranks, where the mesh cannot be cut as asked, or leaves an image.
    """
    with clock.phase(Phase.START):
        inputs, region_mesh = choose_solver(team, inputs, region_mesh)
        # The waves of the mesh here: rank 0 has less to do than who seeks the coarse field, and all need them later.
        parts, _, found = team.together(lambda: (
            None if region_mesh is None else split_region(region_mesh, team.size),
            region_mesh and region_mesh.probe, meanwhile()))
    problem = _read_and_assemble(team, inputs, region_mesh, parts, clock)
    case = inputs.case
    if case.solver.method != "dual" or case.regularization is None or problem.region.n_subdomains == 1:
        # Without regularization a blank part is singular whatever the partition, and the factorisation says where.
        return problem, found
    with clock.phase(Phase.ASSEMBLE):
        joining = join_blank_subdomains(team, region_mesh, problem.references, [m[0] for m in problem.hessians],
                                        case.correlation.spline_degree)
    if joining is None:
        return problem, found
    return _read_and_assemble(team, inputs, region_mesh, joining.parts, clock, (joining.note,)), found


def _describe_discontinuities(team: Team, region_mesh: RegionMesh | None) -> tuple[str, ...]:
    """How much of the mesh is cut, where it is; collective."""

    def describe() -> tuple[str, ...]:
        region = require_held(region_mesh).discontinuous
        return () if region is None else (f"discontinuities: {region.describe()}",)

    return team.on_root(describe)


def _read_and_assemble(team: Team, inputs: Inputs, region_mesh: RegionMesh | None, parts: NDArray[np.int64] | None,
                       clock: PhaseClock, notes: tuple[str, ...] = ()) -> ReferenceProblem:
    case = inputs.case
    with clock.phase(Phase.START):
        subdomains, region = scatter_region(team, region_mesh, parts)
    with clock.phase(Phase.READ):
        references = team.together(lambda: read_reference_views(case, inputs.cameras, subdomains))
        n_pixels = sum(team.gather_lists([view.n_pixels for r in references for view in r.views]))
    with clock.phase(Phase.ASSEMBLE):
        hessians = assemble_hessians(team, clock.note_each(references))
    lines = _describe_discontinuities(team, region_mesh)
    notes = (*inputs.notes, *notes, *lines, *note_crowded_cores(team, case.solver.threads),
             *describe_missing_packages(case.solver.method))
    return ReferenceProblem(inputs, region, references, hessians, n_pixels, notes)


@dataclass(frozen=True)
class Joining:
    """A partition in which no subdomain is blank.

    Attributes
    ----------
    parts : (n_cells,) array of int64 or None
        New subdomain of each cell, on rank 0.
    note : str
        What the user should know.
    """

    parts: NDArray[np.int64] | None
    note: str


@dataclass(frozen=True)
class _Piece:
    """A connected piece of a subdomain; cells: their numbers in the whole mesh."""

    subdomain: int
    camera: int
    cells: NDArray[np.int64]
    texture: Texture


def join_blank_subdomains(team: Team, region_mesh: RegionMesh | None, references: Sequence[ReferenceViews],
                          hessians: Sequence[sparse.csr_matrix], degree: int) -> Joining | None:
    """Merge subdomains, or loose pieces of them, without texture with neighbours of the same camera; collective.

    The whole mesh is on rank 0. ``hessians`` are M of each owned subdomain by its own camera, on displacements of nodes
    in the image; ``degree`` is the spline's. None where no subdomain is blank, and where all are. Raises InputError on
    all ranks, where fewer subdomains than ranks are left.
    """
    pieces = team.together(lambda: [
        piece for reference, hessian in zip(references, hessians, strict=True)
        for piece in _find_pieces(reference, hessian, degree)])
    # Everybody holds the same list of the same numbers, hence comes to the same decision.
    owner = np.array(team.gather_lists([piece.subdomain for piece in pieces]))
    cameras = np.array(team.gather_lists([piece.camera for piece in pieces]))
    textures = team.gather_lists([piece.texture for piece in pieces])
    blank = _find_blank(textures, cameras)
    if not blank.any():
        return None
    cells = team.gather_to([piece.cells for piece in pieces])

    def merge() -> NDArray[np.int64]:
        by_piece = [c for of_rank in require_held(cells) for c in of_rank]
        parts = _merge(require_held(region_mesh), by_piece, owner, blank)
        _refuse_too_few(parts, len(np.unique(owner)), team.size)
        return parts

    parts = team.build_on_root(merge)
    n_left = team.on_root(lambda: int(require_held(parts).max()) + 1)
    return Joining(parts, _describe(owner, blank, n_left))


def _find_pieces(reference: ReferenceViews, hessian: sparse.csr_matrix, degree: int) -> list[_Piece]:
    subdomain, correlation = reference.subdomain, reference.own.correlation
    labels = find_connected_pieces(find_adjacent_cells(subdomain.mesh))
    n_pieces = int(labels.max()) + 1
    if n_pieces == 1:
        whole = measure_texture(correlation, hessian, degree)
        return [_Piece(subdomain.index, subdomain.camera, subdomain.cell_ids, whole)]
    pieces = []
    for k in range(n_pieces):
        cells = np.flatnonzero(labels == k)
        alone = restrict_to_cells(correlation, cells)
        of_piece = measure_texture(alone, alone.assemble_hessian(), degree)
        pieces.append(_Piece(subdomain.index, subdomain.camera, subdomain.cell_ids[cells], of_piece))
    return pieces


def _find_blank(textures: Sequence[Texture], cameras: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which pieces are blank, (n_pieces,), by comparison with those of the same camera; none where all of one are."""
    blank = np.zeros(len(textures), dtype=bool)
    for camera in np.unique(cameras):
        places = np.flatnonzero(cameras == camera)
        found = find_blank_subdomains([textures[k] for k in places])
        # Where all are blank, there is no neighbour to join: the factorisation says where.
        blank[places] = found & ~found.all()
    return blank


def _merge(region_mesh: RegionMesh, cells: Sequence[NDArray[np.int64]], owner: NDArray[np.int64],
           blank: NDArray[np.bool_]) -> NDArray[np.int64]:
    """New subdomain of each cell, (n_cells,); cells: of each piece."""
    mesh = region_mesh.mesh
    pieces = np.empty(mesh.n_cells, dtype=np.int64)
    for number, members in enumerate(cells):
        pieces[members] = number
    return merge_blank(pieces, owner, _adjacency_within_cameras(region_mesh), blank)


def _adjacency_within_cameras(region_mesh: RegionMesh) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cells that share a facet, of one camera, as ``find_adjacent_cells`` gives them."""
    indptr, indices = find_adjacent_cells(region_mesh.mesh)
    cameras = region_mesh.cameras
    row = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
    same = cameras[row] == cameras[indices]
    counts = np.bincount(row[same], minlength=len(indptr) - 1)
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64), indices[same]


def _refuse_too_few(parts: NDArray[np.int64], n_before: int, n_ranks: int) -> None:
    n_left = int(parts.max()) + 1
    if n_left < n_ranks:
        raise InputError(
            f"{n_before - n_left} of {n_before} subdomains hold no texture and join a neighbour, which leaves {n_left} "
            f"for {n_ranks} MPI ranks, but every rank needs at least one; start at most {n_left} ranks or ask for more "
            "subdomains (solver.subdomains)")


def _describe(owner: NDArray[np.int64], blank: NDArray[np.bool_], n_left: int) -> str:
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
                   build_mesh=lambda: (updated.build_moved_mesh(image.width, image.height), None),
                   updated=updated, notes=())


def _describe_first(team: Team, problem: ReferenceProblem) -> UpdatedReference:
    """The mesh and its parts in the first reference image; collective."""
    region = problem.region
    nodes, parts = np.empty((region.n_nodes, 2)), np.empty(region.n_cells, dtype=np.int64)
    for index, node_ids, of_nodes, cell_ids in team.gather_lists(
            [(s.index, s.node_ids, s.mesh.nodes, s.cell_ids) for s in problem.subdomains]):
        nodes[node_ids], parts[cell_ids] = of_nodes, index
    inputs = problem.inputs
    first_image = inputs.cameras[0].reference.image
    return UpdatedReference(nodes, np.zeros(nodes.shape), parts, first_image, inputs.build_mesh)
