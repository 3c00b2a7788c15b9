"""Local systems of owned subdomains: M_s, Kbar_s, P and eta from the reference images; and which ones a frame renews.

A system fits as long as it holds the unknowns that pixels of the frame hold, and no others.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy import sparse

from ddic.arrays import Array, BoolArray, IntArray
from ddic.case.schema import RegularizationSection
from ddic.errors import InputError, as_collective, list_first
from ddic.functionals.correlation import LARGE, measure_deformation
from ddic.functionals.regularization import (
    controlled_stiffness,
    find_cut_off_weight,
    find_edge_weight,
    measure_texture_energies,
)
from ddic.functionals.view import FrameView, View
from ddic.images.binned import Blur
from ddic.inputs.mesh_source import NO_INNER_NODE, weigh_stiffness
from ddic.mesh.mesh import sum_about_nodes
from ddic.mesh.rotation import Rotation
from ddic.parallel.field import ByView, Field
from ddic.parallel.team import Team, require_held
from ddic.partition.subdomain import Subdomain, interface_weights
from ddic.problem.added_forces import STEP_ANGLE, FilledCells, fill_cells, fit_rigid_motion
from ddic.problem.reference_problem import Hessians, ReferenceProblem, add_matrices, project_hessians, weigh_cameras
from ddic.problem.region_mesh import ProbeWaves, Region, build_material
from ddic.problem.residual_model import ResidualModel
from ddic.solvers.local_system import LocalSystem

SINGULAR = 1e-9
"""An operator whose lowest eigenvalue is below this share of the mean diagonal of M is singular: a
smooth displacement of the subdomain changes no grey level that a camera could see. A larger share refuses more."""

T = TypeVar("T")

CHANGED_SHARE = 0.02
"""Share of a subdomain's pixels that must have come or gone since its M was assembled for M to be assembled again. The
fixed point does not depend on M, the speed of convergence does: a larger share costs iterations, a smaller one
factors."""

CHANGED_SIDE = 0.5
"""Side, in cut-off wavelengths, of a square, or cube, of as many pixels as may come or go whatever the share: where
more is hidden together, waves fit in that mechanics do not hold, and the old M holds them back. A larger value costs
iterations."""

LOST_SHARE = 0.5
"""Share of the pixels about an unknown without a row of equilibrium that may be lost without a renewal. The old M
leaves as large a share of its error in every iteration: a larger value costs iterations, a smaller one factors."""

GAINED_SHARE = 0.2
"""Share of the pixels that M counts in a cell by which these may grow without a renewal: too small an M makes steps too
large, and a cell that M counts nothing of is held by nothing. At 1 Gauss-Newton would diverge there."""

HELD_SHARE = 1e-6
"""Share of what hidden pixels gave to M that stays in it where mechanics find the displacement of hidden cells. It
keeps the operator of a subdomain regular that is hidden altogether, and slows down waves that mechanics hold by less,
those longer than 30 cut-off wavelengths. A larger share slows shorter ones. Without mechanics the same
share of the diagonal stays at interfaces, whose nodes a neighbour's pixels may hold alone."""


@dataclass(frozen=True)
class Assembly:
    """Owned local systems and what they have in common.

    Attributes
    ----------
    systems : list of LocalSystem
        Of this rank's subdomains.
    eta, mean_diagonal : float
        Weight of the equilibrium gap, 0 without, and mean of diag M over the first camera's unknowns; both in grey
        levels squared per pixel squared.
    edge_weight : float
        P of rows that are not controlled.
    """

    systems: list[LocalSystem]
    eta: float
    mean_diagonal: float
    edge_weight: float = 0.0

    @property
    def smallest_eigenvalue(self) -> float:
        """Eigenvalue below which an operator counts as singular, grey levels squared per pixel squared."""
        return SINGULAR * self.mean_diagonal

    @property
    def reaction_scale(self) -> float:
        """Scale c = 1 / sqrt(eta mean diag M), which gives Lambda and LambdaBar one unit."""
        return 1.0 if self.eta == 0 else float(1.0 / np.sqrt(self.eta * self.mean_diagonal))


def assemble(team: Team, reference: ReferenceProblem, weights: Sequence[float], rotation: Array | None = None,
             ) -> Assembly:
    """Find eta for the whole region and set up the local systems; collective.

    ``weights`` are those of the cameras' squared grey levels, no unit; ``rotation``, (dim, dim), is that by which the
    specimen has turned, if any. Raises InputError on all ranks, where a cut-off wavelength has no inner node.
    """
    case, subdomains = reference.inputs.case, reference.subdomains
    section, views = case.regularization, weigh_cameras(reference.views, weights)
    projected = team.together(lambda: project_hessians(views, reference.hessians))
    mean_diagonal = _mean_diagonal(team, subdomains, projected, reference.region)
    if section is None:
        systems = [LocalSystem(s, m, None, np.zeros(0), 0.0) for s, m in zip(subdomains, projected, strict=True)]
        return Assembly(systems, 0.0, mean_diagonal)
    eta, edge_weight = _weigh_gap(team, section, reference, views)
    material = build_material(section, case.dim)

    def set_up(subdomain: Subdomain, hessian: sparse.csr_matrix) -> LocalSystem:
        of_rows = interface_weights(subdomain.multiplicity, case.solver.weighting)
        relative = weigh_stiffness(case, subdomain.mesh) if section.stiffness else None
        stiffness = controlled_stiffness(subdomain.kinematics, material, of_rows, rotation, relative)
        if subdomain.n_motion:
            # A camera's motion is no displacement of matter, hence in no equilibrium.
            of_motion = sparse.csr_matrix((stiffness.shape[0], subdomain.n_motion))
            stiffness = sparse.hstack([stiffness, of_motion]).tocsr()
        return LocalSystem(subdomain, hessian, stiffness, of_rows, eta, weigh_rows(subdomain.controlled, edge_weight))

    systems = team.together(lambda: [set_up(s, m) for s, m in zip(subdomains, projected, strict=True)])
    return Assembly(systems, eta, mean_diagonal, edge_weight)


def weigh_rows(controlled: BoolArray, edge_weight: float) -> Array:
    """Give the diagonal of P, Eq. 9 of [BP17]: how much the equilibrium of each unknown counts, small at edges."""
    return np.where(controlled, 1.0, edge_weight)


def find_eta(team: Team, subdomains: Sequence[Subdomain], views: ByView[View], hessians: Hessians,
             probe: ProbeWaves) -> float:
    """Find the weight at which texture and mechanics count alike at the probe's wavelength [LPHR11]; collective.

    Of each subdomain its own camera's texture, weighted, counts. The weight is in grey levels squared per pixel
    squared.
    """
    texture = team.ordered_sum([
        own.weight * measure_texture_energies(s.mesh.nodes, hessian, s.interior, probe.wavelength, probe.axes)
        for s, (own, *_), (hessian, *_) in zip(subdomains, views, hessians, strict=True)])
    return find_cut_off_weight(texture, probe.gap_energies)


def _weigh_gap(team: Team, section: RegularizationSection, reference: ReferenceProblem,
               views: ByView[View]) -> tuple[float, float]:
    """What equilibrium weighs: eta, given or that of the cut-off wavelength, and relative to it that of the edges."""
    if section.eta is not None and section.edge_wavelength == 0:
        return section.eta, 0.0
    probe = require_held(reference.region.probe)
    if not probe.is_weighable:
        if section.eta is None:
            raise as_collective(InputError(f"regularization.cut_off_wavelength: {NO_INNER_NODE}"))
        return section.eta, 0.0
    eta_of_probe = find_eta(team, reference.subdomains, views, reference.hessians, probe)
    eta = eta_of_probe if section.eta is None else section.eta
    return eta, find_edge_weight(eta, (probe.wavelength, eta_of_probe), section.edge_wavelength)


def _mean_diagonal(team: Team, subdomains: Sequence[Subdomain], hessians: Sequence[sparse.csr_matrix],
                   region: Region) -> float:
    """Mean of diag M over the first camera's unknowns: near-field ones would hide what the far-field ones are."""
    shares: list[Array] = []
    for subdomain, hessian in zip(subdomains, hessians, strict=True):
        n_field = subdomain.n_field
        of_first = np.array([hessian.diagonal()[:n_field].sum(), n_field])
        shares.append(of_first * float(subdomain.camera == 0))
    total, n_unknowns = team.ordered_sum(shares)
    several_cameras = team.maximum(max(subdomain.camera for subdomain in subdomains)) > 0
    return float(total) / (float(n_unknowns) if several_cameras else region.n_field)


@dataclass(frozen=True)
class AssembledFrom:
    """What M of owned subdomains was assembled from.

    Pixels by cell: a frame may hide as many as the one before, but others.

    Attributes
    ----------
    n_pixels : ByView of (n_cells,) array
        Pixels that it counts.
    inverse_deformations : ByView of (n_cells, dim, dim) array or None
        F^-1 with which their gradients were turned; None where they were not.
    filled : list of (n_cells,) bool array
        Cells that were given an elastic energy, of each subdomain.
    free : list of (n_field,) bool array
        Unknowns that no pixel holds, which are in equilibrium, of each subdomain.
    rotation : Rotation
        By which the region had turned then.
    blurs : tuple of (int, Blur)
        Of the reference images of cameras.
    """

    n_pixels: ByView[IntArray]
    inverse_deformations: ByView[Array | None]
    filled: list[BoolArray]
    free: list[BoolArray]
    rotation: Rotation
    blurs: tuple[tuple[int, Blur], ...] = ()

    @classmethod
    def all_of(cls, subdomains: Sequence[Subdomain], views: ByView[View]) -> AssembledFrom:
        """Count all pixels of the reference images, with their own gradients."""
        return cls(views.map(View.count_pixels), views.map(lambda _: None),
                   [np.zeros(subdomain.mesh.n_cells, dtype=bool) for subdomain in subdomains],
                   [np.zeros(subdomain.n_field, dtype=bool) for subdomain in subdomains],
                   Rotation.none(subdomains[0].mesh.dim))


@dataclass(frozen=True)
class Renewal:
    """New systems of some subdomains, and what those of all of them are assembled from.

    Attributes
    ----------
    systems : list of LocalSystem or None
        With a new M_s, and P where the frame leaves unknowns without pixels; None where the old one stays.
    assembled_from : AssembledFrom
        What they are made of from now on.
    notes : tuple of str
        What the log says; nothing where nothing changes on any rank.
    filled : FilledCells or None
        The cells that nothing else holds; None where there are none.
    """

    systems: list[LocalSystem | None]
    assembled_from: AssembledFrom
    notes: tuple[str, ...]
    filled: FilledCells | None = None


def find_renewal(model: ResidualModel, q: Field, assembled: tuple[AssembledFrom, Hessians], wavelength: float,
                 assembly: Assembly) -> Renewal:
    """Compare what M was assembled from with what a frame shows; collective.

    The frame is thought to show the specimen at ``q``. ``assembled`` is what M was made of, and M of each view with all
    pixels of the reference, on displacements of nodes in its image; ``wavelength`` is the cut-off wavelength, pixels,
    infinite where eta is given, 0 without regularization; ``assembly`` has the systems of the same subdomains.

    M is new where more than ``_bound_changes`` of a subdomain's pixels have come or gone, or a cell has gained more
    than ``GAINED_SHARE``, or an unknown whose equilibrium is not controlled has lost more than ``LOST_SHARE``; or where
    a cell has turned or stretched by more than ``LARGE`` since, in a frame that asks for it; or where other unknowns
    have no pixels: they are in equilibrium, or, without regularization, their cells are elastic.
    """
    before, of_all_pixels = assembled
    team, subdomains, views, is_regularized = model.team, model.subdomains, model.views, wavelength > 0

    shown = team.together(lambda: views.map(model.show, views.fill(q)))
    n_pixels = shown.map(View.count_pixels)
    in_reference = views.map(lambda view: view.prepared.count_pixels())
    unseen = [~find_held(subdomain, now) for subdomain, now in zip(subdomains, n_pixels, strict=True)]
    if is_regularized:
        # What the reference images do not show either is held as the factor of the reference found.
        unseen = [is_unseen & find_held(subdomain, then)
                  for is_unseen, subdomain, then in zip(unseen, subdomains, in_reference, strict=True)]
    free = _find_free_unknowns(team, subdomains, unseen)
    filled, rotation = None, Rotation.none(subdomains[0].mesh.dim)
    cells = [np.zeros(subdomain.mesh.n_cells, dtype=bool) for subdomain in subdomains]
    if len(free) and not is_regularized:
        cells = [np.sum(of_views, axis=0) == 0 for of_views in n_pixels]
        rotation = fit_rigid_motion(q).rotation
        filled = fill_cells(subdomains, cells, assembly.mean_diagonal, rotation)
    in_equilibrium = free if is_regularized else free[:0]
    is_free = [np.isin(subdomain.kinematics.numbers, in_equilibrium) for subdomain in subdomains]
    is_turned = before.rotation.measure_turn(rotation) > STEP_ANGLE
    now = AssembledFrom(n_pixels, shown.map(lambda view: view.correlation.inverse_deformations), cells, is_free,
                        rotation if is_turned else before.rotation, model.blurs)

    lost, turned, left = [], [], []
    for place, subdomain in enumerate(subdomains):
        most = _bound_changes(int(np.sum(in_reference[place])), wavelength, subdomain.mesh.dim)
        lost.append(not _are_pixels_kept(subdomain, before.n_pixels[place], n_pixels[place], most))
        turns = map(measure_deformation, before.inverse_deformations[place], now.inverse_deformations[place])
        turned.append(max(turns, default=0.0) > LARGE)
        is_refilled = (before.filled[place] != cells[place]).any() or (is_turned and cells[place].any())
        is_freed = ((before.free[place] != is_free[place]) & ~subdomain.controlled).any()
        left.append(bool(is_refilled or is_freed))
    is_other_image = model.blurs != before.blurs
    renewed = [is_other_image or any(reasons) for reasons in zip(lost, turned, left, strict=True)]

    def assemble(view: FrameView, of_shown: FrameView, of_all: sparse.csr_matrix) -> sparse.csr_matrix:
        if not is_regularized:
            return view.project(of_shown.assemble_hessian())
        return view.project(_assemble_with_rest(of_shown, of_all, is_blurred=bool(model.blurs)))

    def set_up(place: int) -> LocalSystem:
        subdomain, old = subdomains[place], assembly.systems[place]
        own = ByView([views[place]])
        (hessian,) = add_matrices(own.map(assemble, [shown[place]], [of_all_pixels[place]]))
        is_filled = np.zeros(subdomain.n_unknowns, dtype=bool)
        if filled is not None:
            hessian = hessian + filled.assemble_operator(place)
            is_filled = filled.stiffness[place].diagonal() > 0
        if not is_regularized:
            (of_reference,) = project_hessians(own, ByView([of_all_pixels[place]]))
            hessian = hessian + _hold_shared(subdomain, of_reference.diagonal() * ~is_filled)
        projection = weigh_rows(subdomain.controlled | is_free[place], assembly.edge_weight)
        return replace(old, hessian=sparse.csr_matrix(hessian), projection=projection)

    systems = team.together(lambda: [set_up(place) if is_new else None for place, is_new in enumerate(renewed)])
    notes = (*_describe(team, subdomains, lost, "lost or gained more pixels than their operators bear: these are "
                                                "renewed"),
             *_describe(team, subdomains, turned, "turned or stretched by more than 10 %: their operators take the "
                                                  "gradient of the deformed image"),
             *_describe(team, subdomains, left, "hold cells that the frame does not show, or shows again, and nothing "
                                                "else holds: these follow their neighbours"))
    if is_other_image:
        notes = (*notes, "all operators take the reference image as sharp as the frame")
    assembled_from = replace(now, n_pixels=ByView(_choose(renewed, now.n_pixels, before.n_pixels)),
                             inverse_deformations=ByView(_choose(renewed, now.inverse_deformations,
                                                                 before.inverse_deformations)),
                             free=_choose(renewed, is_free, before.free))
    return Renewal(systems, assembled_from, notes, filled)


def _bound_changes(n_pixels: int, wavelength: float, dim: int) -> float:
    """Give the largest number of pixels that may come or go without a renewal.

    ``n_pixels`` are those of the subdomain in the reference images, ``wavelength`` is as ``find_renewal`` takes it.
    """
    share = CHANGED_SHARE * n_pixels
    return min(share, (CHANGED_SIDE * wavelength) ** dim) if wavelength > 0 else share


def _choose(is_new: Sequence[bool], new: Sequence[T], old: Sequence[T]) -> list[T]:
    return [b if changed else a for changed, a, b in zip(is_new, old, new, strict=True)]


def _describe(team: Team, subdomains: Sequence[Subdomain], concerned: Sequence[bool], what: str) -> tuple[str, ...]:
    """Say which subdomains of all ranks are concerned; collective."""
    numbers = team.gather_lists([subdomain.index for subdomain, is_concerned
                                 in zip(subdomains, concerned, strict=True) if is_concerned])
    return (f"{len(numbers)} subdomains ({list_first(numbers)}) {what}",) if numbers else ()


def _are_pixels_kept(subdomain: Subdomain, before: Sequence[IntArray], now: Sequence[IntArray], most: float) -> bool:
    """Whether a subdomain's M, which counts the pixels before, still fits those that are shown now."""
    counted, shown = np.sum(before, axis=0), np.sum(now, axis=0)
    if (shown > (1.0 + GAINED_SHARE) * counted).any():
        return False
    n_changed = sum(int(np.abs(a - b).sum()) for a, b in zip(before, now, strict=True))
    if n_changed == 0:
        return True
    lost = sum_pixels(subdomain, now) < (1.0 - LOST_SHARE) * sum_pixels(subdomain, before)
    if (lost & ~subdomain.controlled).any():
        # Without a row of its own it would follow what is left of its pixels as slowly as M counts the others.
        return False
    return n_changed <= most


def _assemble_with_rest(shown: FrameView, of_all: sparse.csr_matrix, *, is_blurred: bool) -> sparse.csr_matrix:
    """M of a view's shown pixels, with a share of that of all pixels, ``of_all``, which mechanics fill."""
    if is_blurred or shown.correlation.inverse_deformations is not None:
        return (1.0 - HELD_SHARE) * shown.assemble_hessian() + HELD_SHARE * of_all
    # As many pixels of a cell are the same ones with the same gradients: most often a few cells of many have others.
    changed = np.flatnonzero(shown.count_pixels() != shown.prepared.count_pixels())
    interpolation = shown.correlation.interpolation
    n_cell_dofs = interpolation.cell_dofs.shape[1]
    entries = interpolation.assemble_matrix(np.ones((len(changed), n_cell_dofs, n_cell_dofs)), changed)
    entries.data[:] = 1.0
    # All cells that these entries sum over: those with a node of a changed one.
    is_near = np.zeros(interpolation.n_dofs, dtype=bool)
    is_near[interpolation.cell_dofs[changed]] = True
    around = np.flatnonzero(is_near[interpolation.cell_dofs].any(axis=1))
    here = (1.0 - HELD_SHARE) * shown.assemble_hessian(around) + HELD_SHARE * shown.prepared.assemble_hessian(around)
    # In place of the old entries: a change added to these would leave their rounding in what is a millionth of them.
    return of_all - of_all.multiply(entries) + here.multiply(entries)


def _hold_shared(subdomain: Subdomain, diagonal: Array) -> sparse.dia_matrix:
    """A share of a diagonal, (n_unknowns,), that makes M_s regular where a neighbour's pixels alone hold unknowns.

    b has nothing of it: the fixed point is the same.
    """
    is_shared = np.zeros(subdomain.n_unknowns, dtype=bool)
    is_shared[:subdomain.n_field] = subdomain.multiplicity > 1
    return sparse.diags(HELD_SHARE * diagonal * is_shared)


def describe_lost_pixels(model: ResidualModel, n_pixels: ByView[IntArray]) -> str:
    """Say how many nodes a frame has taken most pixels from, where operators are singular; collective.

    ``n_pixels`` are those of cells that count in the frame. The reason, with remedies, is given on all ranks; it is
    empty where no node has lost LOST_SHARE of its pixels.
    """
    n_lost = np.zeros(2)
    in_reference = model.views.map(lambda view: view.prepared.count_pixels())
    for subdomain, then, now in zip(model.subdomains, in_reference, n_pixels, strict=True):
        is_lost = sum_pixels(subdomain, now) < (1.0 - LOST_SHARE) * sum_pixels(subdomain, then)
        lost = find_displaced_nodes(subdomain, is_lost)
        parts = subdomain.mesh.parts
        of_line = np.zeros(len(lost), dtype=bool)
        if parts is not None:
            nodes = subdomain.mesh.cells[parts.cells]
            of_line[nodes[nodes >= 0]] = True
        n_lost += np.sum([lost / subdomain.node_multiplicity, lost * of_line / subdomain.node_multiplicity], axis=1)
    n_nodes, n_beside = np.rint(model.team.sum(n_lost)).astype(int).tolist()
    if not n_nodes:
        return ""
    told = (f"{n_nodes} nodes have lost more than {LOST_SHARE:.0%} of the pixels that hold them, which this frame "
            "hides, or shows as something else than the reference image does")
    if n_beside:
        told += (f"; {n_beside} of them stand beside a discontinuity: its line may be off its place, correct "
                 "discontinuity.vertices")
    return f"{told}; mask what is not the specimen, or give regularization.cut_off_wavelength"


def find_held(subdomain: Subdomain, counts: Sequence[IntArray]) -> BoolArray:
    """Find the unknowns that pixels hold, (n_field,): those that displace a node of a cell with pixels."""
    return sum_pixels(subdomain, counts) > 0


def sum_pixels(subdomain: Subdomain, counts: Sequence[IntArray]) -> Array:
    """Sum the pixels of cells about the nodes that an unknown displaces, (n_field,), weighted by how far it does."""
    of_nodes = sum_about_nodes(subdomain.mesh, np.sum(counts, axis=0))
    return np.asarray(abs(subdomain.kinematics.tangent).T @ np.repeat(of_nodes, subdomain.mesh.dim))


def find_displaced_nodes(subdomain: Subdomain, unknowns: BoolArray) -> BoolArray:
    """Find the nodes, (n_nodes,), that some unknowns of the field, (n_field,), displace."""
    is_displaced = abs(subdomain.kinematics.tangent) @ unknowns.astype(float) > 0
    return np.asarray(is_displaced.reshape(subdomain.mesh.nodes.shape).any(axis=1))


def find_unseen_unknowns(team: Team, subdomains: Sequence[Subdomain], n_pixels: ByView[IntArray]) -> IntArray:
    """Find the same where cells of each view have so many pixels that count, (n_cells,); collective."""
    unseen = [~find_held(subdomain, counts) for subdomain, counts in zip(subdomains, n_pixels, strict=True)]
    return _find_free_unknowns(team, subdomains, unseen)


def _find_free_unknowns(team: Team, subdomains: Sequence[Subdomain], unseen: Sequence[BoolArray]) -> IntArray:
    """Find the unknowns that no pixel holds in any subdomain: their sorted numbers in the whole problem; collective.

    ``unseen``, (n_field,), are those without pixels in each owned subdomain.
    """
    copies = [copy for s, is_unseen in zip(subdomains, unseen, strict=True)
              for copy in zip(s.kinematics.numbers[is_unseen].tolist(), s.multiplicity[is_unseen].tolist(),
                              strict=True)]
    # Held in none of the subdomains that share it.
    free = [number for (number, multiplicity), n in Counter(team.gather_lists(copies)).items() if n == multiplicity]
    return np.array(sorted(free), dtype=np.int64)
