"""The whole mesh on rank 0: its unknowns, which camera measures which cell, what cells cost, how it is cut."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ddic.arrays import Array, BoolArray, IntArray
from ddic.case.schema import Case, RegularizationSection, SolverSection
from ddic.errors import InputError
from ddic.functionals.regularization import PHASES, Material, measure_gap_energies
from ddic.inputs.cameras import Camera, MeasuredCells, assign_cells, collect_measured_cells
from ddic.inputs.inputs import Inputs
from ddic.io.text_files import read_partition
from ddic.kinematics.kinematics import RegionKinematics
from ddic.kinematics.linear import TiedRegion
from ddic.kinematics.nodal import NodalRegion
from ddic.mesh.mesh import Mesh, Similarity
from ddic.mesh.raster import rasterize
from ddic.mesh.topology import find_boundary_nodes, find_not_controlled_nodes
from ddic.parallel.distribution import scatter_subdomains
from ddic.parallel.team import Team, require_held
from ddic.partition.build_subdomains import build_subdomains
from ddic.partition.determined import keep_masters_determined, keep_sides_determined
from ddic.partition.split import (
    add_motions,
    estimate_cell_costs,
    find_cameras_at_nodes,
    keep_cameras_apart,
    split_by_blocks,
    split_by_camera,
    split_by_metis,
)
from ddic.partition.subdomain import Subdomain
from ddic.partition.ties import Tying
from ddic.problem.cut_region import CutRegion, cut_region, refuse_kinematics


@dataclass(frozen=True)
class ProbeWaves:
    """Forces of plane waves on the whole mesh.

    Attributes
    ----------
    wavelength : float
        The cut-off wavelength, or, where eta is given, a quarter of the mesh's shorter side; pixels.
    gap_energies : (n_waves,) array
        |K v|^2 of each wave, square pixels.
    """

    wavelength: float
    gap_energies: Array

    @property
    def is_weighable(self) -> bool:
        """Whether every wave loads an inner node, in one of its phases at least."""
        return bool(self.gap_energies.reshape(-1, len(PHASES)).any(axis=1).all())


@dataclass(frozen=True)
class Region:
    """What every rank knows of the whole mesh.

    Attributes
    ----------
    n_nodes, n_cells, n_field, n_subdomains : int
        Numbers of nodes, cells, unknowns of the whole field, and subdomains.
    probe : ProbeWaves or None
        Plane waves that say which eta belongs to which wavelength; None where nothing is regularized.
    mapping : Similarity
        From mesh units to pixels.
    """

    n_nodes: int
    n_cells: int
    n_field: int
    n_subdomains: int
    probe: ProbeWaves | None
    mapping: Similarity


@dataclass(frozen=True)
class RegionMesh:
    """The whole mesh, on rank 0 only.

    Attributes
    ----------
    inputs, kinematics : Inputs, RegionKinematics
        What it was made from; the mesh and its unknowns.
    tying : Tying or None
        How near fields' own meshes are tied in it.
    cameras, costs : (n_cells,) array
        Camera that measures each cell, and the cell's work, pixels.
    measured : list of MeasuredCells
        Cells of each camera.
    controlled : (n_unknowns,) array of bool
        Whether the equilibrium row of each unknown is controlled: P of Eq. 9 of [BP17].
    interior : (n_nodes,) array of bool
        Nodes inside the mesh around which the first camera measures every cell: there texture is weighed against
        mechanics.
    discontinuous : CutRegion, optional
        How discontinuities cut the mesh; None where there are none.
    """

    inputs: Inputs
    kinematics: RegionKinematics
    tying: Tying | None
    cameras: IntArray
    costs: Array
    measured: list[MeasuredCells]
    controlled: BoolArray
    interior: BoolArray
    discontinuous: CutRegion | None = None

    @property
    def mesh(self) -> Mesh:
        """The whole mesh."""
        return self.kinematics.mesh

    @cached_property
    def probe(self) -> ProbeWaves | None:
        """Plane waves that say which eta belongs to which wavelength; None where nothing is regularized."""
        section, mesh = self.inputs.case.regularization, self.mesh
        if section is None:
            return None
        wavelength = section.cut_off_wavelength or float(np.ptp(mesh.nodes, axis=0).min()) / 4
        return ProbeWaves(wavelength, measure_gap_energies(mesh, build_material(section), self.interior, wavelength))

    def describe(self, n_subdomains: int) -> Region:
        """Say what every rank is to know: sizes, and |K v|^2 of plane waves."""
        return Region(self.mesh.n_nodes, self.mesh.n_cells, self.kinematics.n_unknowns, n_subdomains, self.probe,
                      self.mesh.mapping)

    def cut(self, parts: IntArray) -> tuple[list[Subdomain], Array]:
        """Cut the mesh into self-contained subdomains.

        ``parts``, (n_cells,), is the subdomain of each cell; none has cells of two cameras. All subdomains are given,
        by number, with the work of each, (n_subdomains,), pixels.
        """
        # Also where equilibrium is not imposed: a frame may leave these unknowns to it.
        has_row = np.full(self.kinematics.n_unknowns, self.inputs.case.regularization is not None)
        subdomains = build_subdomains(self.kinematics, parts, self.controlled, self.interior, has_row)
        cameras = [int(self.cameras[s.cell_ids[0]]) for s in subdomains]
        n_motion_unknowns = [camera.setup.n_motion_unknowns for camera in self.inputs.cameras]
        subdomains = add_motions(subdomains, cameras, n_motion_unknowns, self.kinematics.n_unknowns)
        return subdomains, np.asarray(np.bincount(parts, weights=self.costs), dtype=np.float64)


def build_region_mesh(inputs: Inputs) -> RegionMesh:
    """Build the whole mesh, not yet cut, and find out which camera measures what; free of communication.

    Raises InputError where the mesh, a selection of nodes, or a near field is refused.
    """
    mesh, tying = inputs.build_mesh()
    cameras, section = inputs.cameras, inputs.case.regularization
    labels = assign_cells(cameras, mesh, tying)
    boundary = find_boundary_nodes(mesh) if tying is None else tying.boundary
    # Boxes and sides are meant in the first reference image.
    in_first = mesh if inputs.updated is None else replace(mesh, nodes=inputs.updated.nodes)
    region = cut_region(inputs, mesh, labels)
    if region is None:
        kinematics, interior = _choose_kinematics(inputs, mesh, tying), np.ones(mesh.n_nodes, dtype=bool)
        measured = seen = collect_measured_cells(cameras, mesh, labels)
    else:
        refuse_kinematics(inputs)
        # The start looks at the region as a whole.
        measured = collect_measured_cells(cameras, mesh, region.cameras)
        kinematics, labels = region.kinematics, region.cameras[region.cell_of]
        seen = collect_measured_cells(cameras, kinematics.mesh, labels)
        boundary, in_first = region.cut.find_with_phantoms(boundary), region.cut.mesh
        interior = region.find_nodes_away_from_lines()
    interior[boundary] = False
    if len(cameras) > 1:
        interior &= _only_first_camera(kinematics.mesh, labels, len(cameras), tying)
    controlled = kinematics.controlled(_controlled_nodes(section, in_first, boundary))
    return RegionMesh(inputs, kinematics, tying, labels, _costs(cameras, kinematics.mesh, seen), measured, controlled,
                      interior, region)


def split_region(region_mesh: RegionMesh, n_ranks: int) -> IntArray:
    """Split the cells as the case says: the subdomain of each, (n_cells,); free of communication.

    No subdomain has cells of two cameras; there are ``n_ranks`` of them where the case says no number. Raises
    InputError where there are not enough cells, cameras or slaves for the subdomains asked for.
    """
    case, mesh, updated = region_mesh.inputs.case, region_mesh.mesh, region_mesh.inputs.updated
    if updated is not None:
        return updated.parts
    n_cameras = len(region_mesh.inputs.cameras)
    if case.solver.method == "monolithic":
        return np.zeros(mesh.n_cells, dtype=np.int64)
    n_subdomains = max(n_ranks, n_cameras)
    if region_mesh.discontinuous is not None:
        return _split_cut(region_mesh, region_mesh.discontinuous, n_subdomains)
    parts = _split_whole(case.solver, mesh, region_mesh.cameras, region_mesh.costs, n_subdomains)
    if region_mesh.tying is not None:
        parts = keep_masters_determined(mesh, region_mesh.tying, parts)
    return parts


def _split_whole(solver: SolverSection, mesh: Mesh, labels: IntArray, costs: Array, n_subdomains: int) -> IntArray:
    """Subdomain of each cell of a mesh without cut cells; as many as asked for where the case says no number."""
    parts = _given_parts(solver, mesh)
    if parts is not None:
        return keep_cameras_apart(parts, labels) if labels.any() else parts
    return split_by_camera(labels, costs, solver.subdomains or n_subdomains,
                           lambda cells, n: split_by_metis(mesh.create_submesh(cells)[0], n, costs[cells]))


def _split_cut(region_mesh: RegionMesh, region: CutRegion, n_subdomains: int) -> IntArray:
    """Subdomain of each cell of a cut mesh: the mesh is split before it is cut, so that parts of a cell stay together.

    What opens along or across the line only is determined by what lies on both sides of it.
    """
    cell_of = region.cell_of
    costs = np.bincount(cell_of, weights=region_mesh.costs).astype(np.float64)
    parts = _split_whole(region_mesh.inputs.case.solver, region.whole, region.cameras, costs, n_subdomains)
    return keep_sides_determined(region.sides, region.cameras, parts)[cell_of]


def scatter_region(team: Team, region_mesh: RegionMesh | None,
                   parts: IntArray | None) -> tuple[list[Subdomain], Region]:
    """Cut the mesh that rank 0 holds and give each rank its subdomains; collective.

    ``parts``, (n_cells,), is the subdomain of each cell, on rank 0. Raises InputError on all ranks, where there are
    fewer subdomains than ranks.
    """
    subdomains = scatter_subdomains(team, lambda: require_held(region_mesh).cut(require_held(parts)))
    region = team.on_root(lambda: require_held(region_mesh).describe(int(require_held(parts).max()) + 1))
    return subdomains, region


def build_material(section: RegularizationSection) -> Material:
    """Give the elastic constants of the regularization, with E = 1."""
    return Material(section.poisson_ratio, section.plane)


def compute_cut_off_wavelength(case: Case) -> float:
    """Find the wavelength below which mechanics hold the displacement, pixels.

    It is 0 without regularization, infinite where eta is given.
    """
    section = case.regularization
    if section is None:
        return 0.0
    return np.inf if section.cut_off_wavelength is None else section.cut_off_wavelength


def _choose_kinematics(inputs: Inputs, mesh: Mesh, tying: Tying | None) -> RegionKinematics:
    if tying is not None:
        if inputs.choose_kinematics is not None:
            raise InputError("kinematics: near fields with meshes of their own have kinematics of their own; "
                             "leave near.mesh or the kinematics out")
        return TiedRegion(mesh, tying.weights)
    return NodalRegion(mesh) if inputs.choose_kinematics is None else inputs.choose_kinematics(mesh)


def _costs(cameras: Sequence[Camera], mesh: Mesh, measured: Sequence[MeasuredCells]) -> Array:
    """Work of each cell, (n_cells,), pixels: those of its camera, and of the first one where that measures it too."""
    costs = np.zeros(mesh.n_cells)
    for camera, cells in zip(cameras, measured, strict=True):
        costs[cells.cells] = estimate_cell_costs(cells.seen)
        if camera.use_far:
            costs[cells.cells] += rasterize(cells.mesh).pixel_counts
    return costs


def _only_first_camera(mesh: Mesh, labels: IntArray, n_cameras: int, tying: Tying | None) -> BoolArray:
    """Whether the first camera alone measures around each node, (n_nodes,); never at slaves, which are near nodes."""
    at_nodes = find_cameras_at_nodes(mesh, labels, n_cameras, None if tying is None else tying.weights)
    only_first = np.zeros(mesh.n_nodes, dtype=bool)
    only_first[:len(at_nodes)] = ~at_nodes[:, 1:].any(axis=1)
    return only_first


def _controlled_nodes(section: RegularizationSection | None, mesh: Mesh, boundary: IntArray) -> BoolArray:
    """Whether the equilibrium of each node is controlled, (n_nodes,)."""
    controlled = np.full(mesh.n_nodes, section is not None)
    if section is not None:
        controlled[find_not_controlled_nodes(mesh, section.not_controlled, section.boxes, boundary)] = False
    return controlled


def _given_parts(solver: SolverSection, mesh: Mesh) -> IntArray | None:
    """Subdomain of each cell where the case gives blocks or a file, (n_cells,); None where METIS is to find it."""
    if solver.blocks is not None:
        return split_by_blocks(mesh, solver.blocks)
    if solver.partition_file is not None:
        return read_partition(solver.partition_file, mesh.n_cells)
    return None
