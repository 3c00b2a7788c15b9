"""The whole mesh on rank 0: its unknowns, cut by discontinuities; who measures its cells, what they cost, its split."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ddic.arrays import Array, BoolArray, IntArray
from ddic.case.schema import Case, RegularizationSection, SolverSection
from ddic.errors import InputError
from ddic.functionals.line_band import weigh_corners
from ddic.functionals.regularization import PHASES, HalfAmplitudes, Material, find_half_amplitudes, sum_wave_forces
from ddic.inputs.cameras import Camera, MeasuredCells, assign_cells, collect_measured_cells
from ddic.inputs.inputs import Inputs
from ddic.io.text_files import read_partition
from ddic.kinematics.enriched import Discontinuities, EnrichedRegion, enrich
from ddic.kinematics.kinematics import RegionKinematics
from ddic.kinematics.linear import TiedRegion
from ddic.kinematics.nodal import NodalRegion
from ddic.kinematics.tip_functions import TipPatch, enrich_at_tips, find_bends_at_tips, find_tips
from ddic.mesh.cut_mesh import CutMesh, cut_mesh, is_cut_by
from ddic.mesh.mesh import Mesh, Similarity
from ddic.mesh.quality import measure_areas, measure_cell_size
from ddic.mesh.raster import rasterize
from ddic.mesh.topology import find_boundary_nodes, find_not_controlled_nodes
from ddic.parallel.distribution import scatter_subdomains, sum_shared_nodes
from ddic.parallel.team import Team, require_held
from ddic.partition.determined import CutSides, keep_cameras_determined, keep_masters_determined, keep_sides_determined
from ddic.partition.sharing import cut_subdomains, number_interfaces
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

LEAST_OPEN = 0.5
"""Share of the cut elements with unknowns of the jump below which its loss is told. Where a line runs obliquely those
without, a third of 6-px elements, follow others near by."""


@dataclass(frozen=True, eq=False)
class _CutRegion:
    """A mesh that discontinuities cut, with its unknowns and the camera that measures each whole cell.

    ``sides`` is the cut mesh with unknowns on both sides of the lines, ``kinematics`` the same with those of tip
    functions and small cells about the tips; ``cell_of`` is the whole mesh's cell that each of its cells is, or lies
    in.
    """

    whole: Mesh
    sides: CutSides
    cameras: IntArray
    kinematics: EnrichedRegion
    cell_of: IntArray

    @property
    def cut(self) -> CutMesh:
        """The mesh cut by lines, without small cells."""
        return self.sides.cut

    def find_nodes_away_from_lines(self) -> BoolArray:
        """Tell which nodes are no corners of cut cells or of small ones, (kinematics.mesh.n_nodes,)."""
        cut, n_nodes = self.cut, self.kinematics.mesh.n_nodes
        away = np.ones(n_nodes, dtype=bool)
        away[cut.find_with_phantoms(cut.node_of[cut.find_cut_nodes()])] = False
        for cells in self.sides.around_tips:
            away[cut.find_with_phantoms(self.whole.cells[cells].ravel())] = False
        away[cut.mesh.n_nodes:] = False
        return away

    def describe(self) -> str:
        """Say in a line of the log how much is cut, and where that opens hardly anything."""
        cut, n_of_nodes = self.cut, (int(self.cut.node_of.max()) + 1) * self.cut.mesh.dim
        told = f"{describe_cut(cut)}, {self.kinematics.n_unknowns - n_of_nodes} more unknowns"
        parts = np.zeros(0, np.int64) if cut.mesh.parts is None else cut.mesh.parts.cells
        opens = np.isin(cut.mesh.cells[parts], self.sides.kinematics.seen_at[n_of_nodes:]).any(axis=1)
        n_cut, n_open = (len(np.unique(cut.cell_of[of_cut])) for of_cut in (parts, parts[opens]))
        if n_open >= LEAST_OPEN * n_cut:
            return told
        return (f"{told}: {n_cut - n_open} of these elements have too few pixels beside the line to part, and what "
                "opens there is lost; use larger elements, or move the mesh by half of one")


def describe_cut(cut: CutMesh) -> str:
    """Say in a line of ``ddic check`` how much of a mesh is cut."""
    parts = cut.mesh.parts
    n_lines = 0 if parts is None else len(parts.lines.polylines)
    n_cut = 0 if parts is None else len(np.unique(cut.cell_of[parts.cells]))
    lines = "1 line cuts" if n_lines == 1 else f"{n_lines} lines cut"
    return f"{lines} {n_cut} elements"


def list_discontinuities(case: Case) -> Discontinuities:
    """Give the case's discontinuities whose lines are known, pixels."""
    known = [section for section in case.discontinuity if section.vertices is not None]
    return Discontinuities(tuple(np.array(section.vertices) for section in known),
                           tuple(section.opening for section in known))


def _cut_region(inputs: Inputs, mesh: Mesh, labels: IntArray) -> _CutRegion | None:
    """Cut a mesh by the case's discontinuities; None where there are none.

    ``labels``, (n_cells,), give the camera that measures each cell. Cells of a near camera whose pixels do not tell
    what is beyond a line go to the first one, together with those that do. Raises InputError where a line crosses no
    element from side to side.
    """
    discontinuities = list_discontinuities(inputs.case)
    if not discontinuities.lines:
        return None
    check_lines(inputs.case, mesh)
    cut, patch = cut_by_lines(inputs.case, mesh)
    around_tips = () if patch is None else tuple(tip.cells for tip in patch.tips)
    while True:
        measured = collect_measured_cells(inputs.cameras, cut.mesh, labels[cut.cell_of])
        weights = _weigh_corners(cut, measured, inputs.case.correlation.spline_degree)
        sides = CutSides(cut, enrich(cut, weights, discontinuities.openings), weights, around_tips)
        kept = keep_cameras_determined(sides, labels)
        if np.array_equal(kept, labels):
            break
        labels = kept
    if patch is None:
        return _CutRegion(mesh, sides, labels, sides.kinematics, cut.cell_of)
    return _CutRegion(mesh, sides, labels, *enrich_at_tips(cut, sides.kinematics, patch))


def cut_by_lines(case: Case, mesh: Mesh) -> tuple[CutMesh, TipPatch | None]:
    """Cut a mesh by the case's lines; beside it, small cells about tips, whose nodes these are kept clear of too."""
    lines = list_discontinuities(case).lines
    patch = find_tips(mesh, lines, list_tip_functions(case))
    return cut_mesh(mesh, lines, None if patch is None else patch.small.nodes), patch


def list_tip_functions(case: Case) -> list[bool]:
    """List by line of ``list_discontinuities`` whether the case asks for tip functions about the line's ends."""
    return [section.tip_functions for section in case.discontinuity if section.vertices is not None]


def _weigh_corners(cut: CutMesh, measured: Sequence[MeasuredCells], degree: int) -> Array:
    """How firmly pixels of cells hold their nodes, (len(connectivity),), in square pixels of the first camera."""
    mesh = cut.mesh
    cell_of_corner = np.repeat(np.arange(mesh.n_cells), np.diff(mesh.offsets))
    beside = cut.find_cells_at_phantoms()
    weights = np.zeros(len(mesh.connectivity))
    for of_camera in measured:
        own = np.flatnonzero(np.isin(of_camera.cells, beside)).astype(np.int64)
        seen = weigh_corners(of_camera.seen, own, degree)
        scale = measure_areas(of_camera.mesh) / measure_areas(of_camera.seen)
        corners = np.isin(cell_of_corner, of_camera.cells)
        weights[corners] = seen * np.repeat(scale, np.diff(of_camera.seen.offsets))
    return weights


def refuse_kinematics(inputs: Inputs) -> None:
    """Refuse, with an InputError, kinematics of one's own beside discontinuities."""
    if inputs.choose_kinematics is not None:
        raise InputError("kinematics: discontinuities have kinematics of their own; leave one of them out")


def check_lines(case: Case, mesh: Mesh) -> None:
    """Check that every discontinuity cuts the mesh, and that one with tip functions ends in it.

    Raises InputError where a line crosses no element from side to side, or has no tip.
    """
    idle = [k for k, line in enumerate(list_discontinuities(case).lines, start=1) if not is_cut_by(mesh, line)]
    problems = [f"discontinuity, entry {k}: its line crosses no element of the mesh from side to side; correct "
                "discontinuity.vertices (px), or use smaller elements" for k in idle]
    for k, section in enumerate(case.discontinuity, start=1):
        if section.tip_functions:
            problems += _check_tips(f"discontinuity, entry {k}", mesh, np.array(section.vertices))
    if problems:
        raise InputError(problems)


def _check_tips(entry: str, mesh: Mesh, line: Array) -> list[str]:
    """What is wrong with a line about whose ends there are to be tip functions."""
    if find_tips(mesh, [line], [True]) is None:
        return [f"{entry}: tip_functions = true, but neither end of its line lies in the mesh; give the line up to the "
                "crack's tip, or leave tip_functions out"]
    bends = find_bends_at_tips(mesh, line)
    if len(bends):
        x, y = bends[0]
        return [f"{entry}: tip_functions = true, but its line bends at ({x:g}, {y:g}) px, next to the tip; give a line "
                "that is straight for two elements behind it, or leave tip_functions out"]
    return []


@dataclass(frozen=True)
class ProbeWaves:
    """Forces of plane waves on the whole mesh.

    Attributes
    ----------
    wavelength : float
        The cut-off wavelength, or, where eta is given, a quarter of the mesh's shorter side; pixels.
    gap_energies : (n_waves,) array
        |K v|^2 of each wave, square pixels.
    axes : (2, 2) array
        Of the material, which the waves run along.
    """

    wavelength: float
    gap_energies: Array
    axes: Array

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
    shorter_side : float
        Of the box about the mesh, pixels.
    mapping : Similarity
        From mesh units to pixels.
    notes : tuple of str
        What the user should know of it.
    probe : ProbeWaves or None
        Plane waves that say which eta belongs to which wavelength; None where nothing is regularized.
    """

    n_nodes: int
    n_cells: int
    n_field: int
    n_subdomains: int
    shorter_side: float
    mapping: Similarity
    notes: tuple[str, ...] = ()
    probe: ProbeWaves | None = None


@dataclass(frozen=True)
class RegionSizes:
    """What the choice of a solver asks of a region.

    Attributes
    ----------
    n_unknowns, n_cells, n_whole_cells : int
        Unknowns of the field, cells, and cells before discontinuities cut them.
    cell_size : float
        Root of the cells' mean area, pixels.
    work : float
        Of all cells, pixels.
    is_plain : bool
        Whether one camera measures displacements of nodes, on a mesh that nothing cuts or ties.
    """

    n_unknowns: int
    n_cells: int
    n_whole_cells: int
    cell_size: float
    work: float
    is_plain: bool


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
    discontinuous : _CutRegion, optional
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
    discontinuous: _CutRegion | None = None

    @property
    def mesh(self) -> Mesh:
        """The whole mesh."""
        return self.kinematics.mesh

    def measure_sizes(self) -> RegionSizes:
        """Measure what the choice of a solver asks for."""
        whole = self.mesh if self.discontinuous is None else self.discontinuous.whole
        is_plain = (len(self.inputs.cameras) == 1 and self.tying is None and self.discontinuous is None
                    and self.inputs.choose_kinematics is None)
        return RegionSizes(self.kinematics.n_unknowns, self.mesh.n_cells, whole.n_cells, measure_cell_size(self.mesh),
                           float(self.costs.sum()), is_plain)

    def describe(self, n_subdomains: int) -> Region:
        """Say what every rank is to know: sizes, and how much is cut."""
        notes = () if self.discontinuous is None else (f"discontinuities: {self.discontinuous.describe()}",)
        return Region(self.mesh.n_nodes, self.mesh.n_cells, self.kinematics.n_unknowns, n_subdomains,
                      float(np.ptp(self.mesh.nodes, axis=0).min()), self.mesh.mapping, notes)

    def cut(self, parts: IntArray) -> tuple[list[Subdomain], Array]:
        """Cut the mesh into subdomains that do not know yet what they share.

        ``parts``, (n_cells,), is the subdomain of each cell; none has cells of two cameras. All subdomains are given,
        by number, with the work of each, (n_subdomains,), pixels.
        """
        subdomains = [replace(s, camera=int(self.cameras[s.cell_ids[0]]))
                      for s in cut_subdomains(self.kinematics, parts, self.controlled, self.interior)]
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
    region = _cut_region(inputs, mesh, labels)
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
    if solver.blocks is not None:
        parts = split_by_blocks(mesh, solver.blocks)
    elif solver.partition_file is not None:
        parts = read_partition(solver.partition_file, mesh.n_cells)
    else:
        return split_by_camera(labels, costs, solver.subdomains or n_subdomains,
                               lambda cells, n: split_by_metis(mesh.create_submesh(cells)[0], n, costs[cells]))
    return keep_cameras_apart(parts, labels) if labels.any() else parts


def _split_cut(region_mesh: RegionMesh, region: _CutRegion, n_subdomains: int) -> IntArray:
    """Subdomain of each cell of a cut mesh: the mesh is split before it is cut, so that parts of a cell stay together.

    What opens along or across the line only is determined by what lies on both sides of it.
    """
    cell_of = region.cell_of
    costs = np.bincount(cell_of, weights=region_mesh.costs).astype(np.float64)
    parts = _split_whole(region_mesh.inputs.case.solver, region.whole, region.cameras, costs, n_subdomains)
    return keep_sides_determined(region.sides, region.cameras, parts)[cell_of]


def scatter_region(team: Team, inputs: Inputs, region_mesh: RegionMesh | None,
                   parts: IntArray | None) -> tuple[list[Subdomain], Region]:
    """Cut the mesh that rank 0 holds and give each rank its subdomains; collective.

    ``parts``, (n_cells,), is the subdomain of each cell, on rank 0. Raises InputError on all ranks, where there are
    fewer subdomains than ranks.
    """
    subdomains = scatter_subdomains(team, lambda: require_held(region_mesh).cut(require_held(parts)))
    region = team.on_root(lambda: require_held(region_mesh).describe(int(require_held(parts).max()) + 1))
    return finish_region(team, inputs, subdomains, region)


def finish_region(team: Team, inputs: Inputs, subdomains: Sequence[Subdomain],
                   region: Region) -> tuple[list[Subdomain], Region]:
    """Number the interfaces of all ranks' subdomains, and measure plane waves on them; collective."""
    section = inputs.case.regularization
    # Also where equilibrium is not imposed: a frame may leave these unknowns to it.
    has_row = [np.full(s.n_field, section is not None) for s in subdomains]
    connected = number_interfaces(subdomains, has_row, team)
    if section is not None:
        region = replace(region, probe=_probe_waves(team, section, connected, region.shorter_side))
    n_motion_unknowns = [camera.setup.n_motion_unknowns for camera in inputs.cameras]
    if any(n_motion_unknowns):
        n_chain_rows = team.sum(sum(s.n_owned_rows for s in connected))
        cameras = team.gather_lists([s.camera for s in connected])
        connected = add_motions(connected, cameras, n_motion_unknowns, region.n_field, n_chain_rows)
    return connected, region


def _probe_waves(team: Team, section: RegularizationSection, subdomains: Sequence[Subdomain],
                 shorter_side: float) -> ProbeWaves:
    """Plane waves on all subdomains, the same to the last bit on any number of ranks; collective."""
    material = build_material(section, subdomains[0].mesh.dim)
    wavelength = section.cut_off_wavelength or shorter_side / 4
    of_subdomains = team.together(lambda: [sum_wave_forces(s.mesh, material, wavelength) for s in subdomains])
    # By node, of which each copy counts its share.
    at_nodes = sum_shared_nodes(team, subdomains, [forces.reshape(s.mesh.n_nodes, -1)
                                                   for s, forces in zip(subdomains, of_subdomains, strict=True)])
    energies = [((forces[s.interior]**2) / s.node_multiplicity[s.interior, None]).sum(axis=0)
                for s, forces in zip(subdomains, at_nodes, strict=True)]
    n_waves = of_subdomains[0].shape[1]
    return ProbeWaves(wavelength, team.ordered_sum(energies).reshape(-1, n_waves).sum(axis=0), material.axes)


def build_material(section: RegularizationSection, dim: int) -> Material:
    """Give the elastic constants of the regularization, with E = 1, or E2 = 1."""
    plane = section.plane if dim == 2 else None
    return Material(section.poisson_ratio, plane, section.young_ratio, section.shear_ratio,
                    math.radians(section.material_angle_degrees))


def compute_cut_off_wavelength(case: Case) -> float:
    """Find the wavelength below which mechanics rule, pixels: 0 without regularization, infinite where eta is given."""
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
    if inputs.choose_kinematics is None:
        return NodalRegion(mesh)
    if inputs.case.solver.method == "matching":
        raise InputError('kinematics: solver.method = "matching" asks for unknowns that displace nodes; use another '
                         "method")
    return inputs.choose_kinematics(mesh)


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


def describe_cut_off(section: RegularizationSection | None, dim: int) -> HalfAmplitudes | None:
    """Say what a cut-off wavelength means, pixels; None where none is given."""
    if section is None or section.cut_off_wavelength is None:
        return None
    if section.operator == "tikhonov":
        # 1 / (1 + (l_c / l)^2) of a wave of any direction is left.
        return HalfAmplitudes(section.cut_off_wavelength, section.cut_off_wavelength)
    return find_half_amplitudes(build_material(section, dim), section.cut_off_wavelength)
