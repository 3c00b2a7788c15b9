"""Which subdomains' systems no longer fit what a frame shows, its pixels and their gradient, and their new ones.

A system fits as long as it holds the unknowns that pixels of the frame hold, and no others.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.errors import list_first
from ddic.functionals.correlation import LARGE, measure_deformation
from ddic.functionals.view import View
from ddic.images.binned import Blur
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.problem.assembly import Assembly, Hessians
from ddic.problem.region_rotation import STEP_ANGLE, fit_rigid_motion, measure_turn
from ddic.problem.residual_model import ByView, FilledCells, fill_cells, find_inverse_deformations
from ddic.problem.views import FrameViews, ReferenceViews
from ddic.solvers.local_system import LocalSystem

T = TypeVar("T")

CHANGED_SHARE = 0.02
"""Share of a subdomain's pixels that must have come or gone since its M was assembled for M to be assembled again. The
fixed point does not depend on M, the speed of convergence does: a larger share costs iterations, a smaller one
factors."""

CHANGED_SIDE = 0.5
"""Side, in cut-off wavelengths, of a square of as many pixels as may come or go whatever the share: where more is
hidden together, waves fit in that mechanics do not hold, and the old M holds them back. A larger value costs
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

CellCounts = tuple[NDArray[np.int64], ...]
"""Pixels of each cell, (n_cells,), by view of a subdomain."""


@dataclass(frozen=True)
class RenewalRule:
    """When M is renewed.

    Attributes
    ----------
    wavelength : float
        Cut-off wavelength, pixels; infinite where eta is given, 0 without regularization.
    follows : bool
        Whether the frame turns or stretches the specimen so much that M takes the gradient of its image.
    blurs : tuple of (int, Blur)
        Of the reference images of cameras whose frame is less sharp.
    """

    wavelength: float
    follows: bool = False
    blurs: tuple[tuple[int, Blur], ...] = ()

    @property
    def is_regularized(self) -> bool:
        """Whether mechanics find the displacement of hidden cells."""
        return self.wavelength > 0

    def bound_changes(self, n_pixels: int) -> float:
        """Give the largest number of pixels that may come or go without a renewal.

        ``n_pixels`` are those of the subdomain in the reference images.
        """
        share = CHANGED_SHARE * n_pixels
        return min(share, (CHANGED_SIDE * self.wavelength) ** 2) if self.is_regularized else share


@dataclass(frozen=True)
class AssembledFrom:
    """What M of owned subdomains was assembled from.

    Pixels by cell: a frame may hide as many as the one before, but others.

    Attributes
    ----------
    by_view : list of tuple of (n_cells,) array
        Pixels that it counts, of each subdomain and view.
    inverse_deformations : list of tuple of (n_cells, 2, 2) array or None
        F^-1 with which their gradients were turned, of each subdomain and view; None where they were not.
    filled : list of (n_cells,) bool array
        Cells that were given an elastic energy, of each subdomain.
    free : list of (n_field,) bool array
        Unknowns that no pixel holds, which are in equilibrium, of each subdomain.
    angle : float
        By which the region had turned then, radians.
    blurs : tuple of (int, Blur)
        Of the reference images of cameras.
    """

    by_view: list[CellCounts]
    inverse_deformations: list[ByView]
    filled: list[NDArray[np.bool_]]
    free: list[NDArray[np.bool_]]
    angle: float = 0.0
    blurs: tuple[tuple[int, Blur], ...] = ()

    @classmethod
    def all_of(cls, references: Sequence[ReferenceViews]) -> AssembledFrom:
        """Count all pixels of the reference images, with their own gradients."""
        return cls([tuple(view.count_pixels() for view in reference.views) for reference in references],
                   [(None,) * len(reference.views) for reference in references],
                   [np.zeros(reference.subdomain.mesh.n_cells, dtype=bool) for reference in references],
                   [np.zeros(reference.subdomain.n_field, dtype=bool) for reference in references])


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


def find_renewal(team: Team, views: Sequence[FrameViews], q: Sequence[NDArray[np.float64]],
                 assembled: tuple[AssembledFrom, Sequence[Hessians]], rule: RenewalRule,
                 assembly: Assembly) -> Renewal:
    """Compare what M was assembled from with what a frame shows; collective.

    The frame is thought to show owned subdomains at ``q``. ``assembled`` is what M was made of, and M of each view with
    all pixels of the reference, on displacements of nodes in its image; ``assembly`` has the systems of the same
    subdomains.

    M is new where more than ``rule.bound_changes`` of a subdomain's pixels have come or gone, or a cell has gained more
    than ``GAINED_SHARE``, or an unknown whose equilibrium is not controlled has lost more than ``LOST_SHARE``; or where
    a cell has turned or stretched by more than ``LARGE`` since, in a frame that asks for it; or where other unknowns
    have no pixels: they are in equilibrium, or, without regularization, their cells are elastic.
    """
    counted, whole = assembled
    shown = team.together(lambda: [tuple(view.without_hidden(q_s) for view in of_subdomain.views)
                                   for of_subdomain, q_s in zip(views, q, strict=True)])
    counts = [tuple(view.count_pixels() for view in of_shown) for of_shown in shown]
    unseen = [_find_unseen(of_subdomain, now, rule) for of_subdomain, now in zip(views, counts, strict=True)]
    subdomains = [of_subdomain.subdomain for of_subdomain in views]
    filled, angle = None, 0.0
    cells = [np.zeros(len(now[0]), dtype=bool) for now in counts]
    free = find_free_unknowns(team, subdomains, unseen)
    if free and not rule.is_regularized:
        cells = [np.sum(now, axis=0) == 0 for now in counts]
        angle = fit_rigid_motion(team, subdomains, q).angle
        filled = fill_cells(team, subdomains, cells, assembly.mean_diagonal, angle)
    in_equilibrium = sorted(free) if rule.is_regularized else []
    is_free = [np.isin(subdomain.kinematics.numbers, in_equilibrium) for subdomain in subdomains]
    now = AssembledFrom(counts, [_find_gradients(of_subdomain, q_s, rule)
                                 for of_subdomain, q_s in zip(views, q, strict=True)],
                        cells, is_free, angle, rule.blurs)
    lost = [not _are_pixels_kept(of_subdomain, a, b, rule)
            for of_subdomain, a, b in zip(views, counted.by_view, now.by_view, strict=True)]
    turned = [not _are_gradients_kept(a, b)
              for a, b in zip(counted.inverse_deformations, now.inverse_deformations, strict=True)]
    is_turned = abs(measure_turn(counted.angle, angle)) > STEP_ANGLE
    refilled = [bool((a != b).any() or (b.any() and is_turned)) for a, b in zip(counted.filled, cells, strict=True)]
    freed = [bool(((a != b) & ~subdomain.controlled).any())
             for a, b, subdomain in zip(counted.free, is_free, subdomains, strict=True)]
    left = [any(reasons) for reasons in zip(refilled, freed, strict=True)]
    is_other_image = rule.blurs != counted.blurs
    renewed = [is_other_image or any(reasons) for reasons in zip(lost, turned, left, strict=True)]

    def assemble(number: int) -> sparse.csr_matrix:
        followed = _follow(shown[number], now.inverse_deformations[number])
        hessian = _assemble_shown(views[number], followed, whole[number], rule)
        if filled is not None:
            hessian = sparse.csr_matrix(hessian + filled.assemble_operator(number))
        if rule.is_regularized:
            return hessian
        is_filled = None if filled is None else filled.stiffness[number].diagonal() > 0
        return _hold_shared(views[number], hessian, whole[number], is_filled)

    def set_up(number: int) -> LocalSystem | None:
        if not renewed[number]:
            return None
        system = replace(assembly.systems[number], hessian=assemble(number))
        return replace(system, projection=_control(assembly, subdomains[number], is_free[number]))

    systems = team.together(lambda: [set_up(number) for number in range(len(views))])
    assembled_from = AssembledFrom(_choose(renewed, now.by_view, counted.by_view),
                                   _choose(renewed, now.inverse_deformations, counted.inverse_deformations),
                                   cells, _choose(renewed, is_free, counted.free),
                                   counted.angle if not is_turned else angle, rule.blurs)
    notes = (*_describe(team, views, lost, "lost or gained more pixels than their operators bear: these are renewed"),
             *_describe(team, views, turned, "turned or stretched by more than 10 %: their operators take the gradient "
                                             "of the deformed image"),
             *_describe(team, views, left, "hold cells that the frame does not show, or shows again, and nothing "
                                               "else holds: these follow their neighbours"))
    if is_other_image:
        notes = (*notes, "all operators take the reference image as sharp as the frame")
    return Renewal(systems, assembled_from, notes, filled)


def _control(assembly: Assembly, subdomain: Subdomain, is_free: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Diagonal of P: what no pixel holds is in equilibrium, as if nothing loaded it."""
    return np.where(subdomain.controlled | is_free, 1.0, assembly.edge_weight)


def _choose(is_new: Sequence[bool], new: Sequence[T], old: Sequence[T]) -> list[T]:
    return [b if changed else a for changed, a, b in zip(is_new, old, new, strict=True)]


def _describe(team: Team, views: Sequence[FrameViews], concerned: Sequence[bool], what: str) -> tuple[str, ...]:
    """Say which subdomains of all ranks are concerned; collective."""
    numbers = team.gather_lists([of_subdomain.subdomain.index for of_subdomain, is_concerned
                                 in zip(views, concerned, strict=True) if is_concerned])
    return (f"{len(numbers)} subdomains ({list_first(numbers)}) {what}",) if numbers else ()


def _find_gradients(of_subdomain: FrameViews, q: NDArray[np.float64], rule: RenewalRule) -> ByView:
    """F^-1 of a subdomain's cells; none where little turns or stretches anywhere."""
    return find_inverse_deformations(of_subdomain, q) if rule.follows else (None,) * len(of_subdomain.views)


def _are_gradients_kept(before: ByView, now: ByView) -> bool:
    """Whether no cell of a subdomain has turned or stretched by much since its M was assembled."""
    changes = [measure_deformation(then, inverse) for then, inverse in zip(before, now, strict=True)]
    return max(changes, default=0.0) <= LARGE


def _follow(shown: Sequence[View], inverse: ByView) -> list[View]:
    """Views whose M takes the gradient of the deformed image."""
    return [replace(view, correlation=replace(view.correlation, inverse_deformations=of_view))
            for view, of_view in zip(shown, inverse, strict=True)]


def _find_unseen(of_subdomain: FrameViews, counts: CellCounts, rule: RenewalRule) -> NDArray[np.bool_]:
    """Which unknowns have pixels in the reference images and none in the frame, (n_field,); without mechanics, none."""
    subdomain = of_subdomain.subdomain
    if not rule.is_regularized:
        return ~find_held(subdomain, counts)
    in_reference = tuple(view.count_pixels() for view in of_subdomain.reference.views)
    if all(np.array_equal(a, b) for a, b in zip(in_reference, counts, strict=True)):
        return np.zeros(subdomain.n_field, dtype=bool)
    # What the reference images do not show either is held as the factor of the reference found.
    return find_held(subdomain, in_reference) & ~find_held(subdomain, counts)


def _are_pixels_kept(of_subdomain: FrameViews, before: CellCounts, now: CellCounts, rule: RenewalRule) -> bool:
    """Whether a subdomain's M, which counts the pixels before, still fits those that are shown now."""
    counted, shown = np.sum(before, axis=0), np.sum(now, axis=0)
    if (shown > (1.0 + GAINED_SHARE) * counted).any():
        return False
    n_changed = sum(int(np.abs(a - b).sum()) for a, b in zip(before, now, strict=True))
    if n_changed == 0:
        return True
    subdomain = of_subdomain.subdomain
    lost = sum_pixels(subdomain, now) < (1.0 - LOST_SHARE) * sum_pixels(subdomain, before)
    if (lost & ~subdomain.controlled).any():
        # Without a row of its own it would follow what is left of its pixels as slowly as M counts the others.
        return False
    n_reference = sum(view.n_pixels for view in of_subdomain.reference.views)
    return n_changed <= rule.bound_changes(n_reference)


def _assemble_shown(of_subdomain: FrameViews, shown: Sequence[View], whole: Sequence[sparse.csr_matrix],
                    rule: RenewalRule) -> sparse.csr_matrix:
    """M_s of the pixels shown, with a share of the others' where mechanics fill what these leave."""
    total = None
    for view, reference, of_shown, of_whole in zip(of_subdomain.views, of_subdomain.reference.views, shown, whole,
                                                   strict=True):
        projected = view.view.project(_assemble_view(of_shown, reference, of_whole, rule))
        total = projected if total is None else total + projected
    return sparse.csr_matrix(total)


def _assemble_view(shown: View, reference: View, whole: sparse.csr_matrix, rule: RenewalRule) -> sparse.csr_matrix:
    """M of one view; whole: that of all pixels of the reference."""
    if not rule.is_regularized:
        return shown.assemble_hessian()
    if rule.blurs or shown.correlation.inverse_deformations is not None:
        return (1.0 - HELD_SHARE) * shown.assemble_hessian() + HELD_SHARE * whole
    # As many pixels of a cell are the same ones with the same gradients: most often a few cells of many have others.
    changed = np.flatnonzero(shown.count_pixels() != reference.count_pixels())
    interpolation = shown.correlation.interpolation
    n_cell_dofs = interpolation.cell_dofs.shape[1]
    entries = interpolation.assemble_matrix(np.ones((len(changed), n_cell_dofs, n_cell_dofs)), changed)
    entries.data[:] = 1.0
    # All cells that these entries sum over: those with a node of a changed one.
    is_near = np.zeros(interpolation.n_dofs, dtype=bool)
    is_near[interpolation.cell_dofs[changed]] = True
    around = np.flatnonzero(is_near[interpolation.cell_dofs].any(axis=1))
    here = (1.0 - HELD_SHARE) * shown.assemble_hessian(around) + HELD_SHARE * reference.assemble_hessian(around)
    # In place of the old entries: a change added to these would leave their rounding in what is a millionth of them.
    return whole - whole.multiply(entries) + here.multiply(entries)


def _hold_shared(of_subdomain: FrameViews, hessian: sparse.csr_matrix, whole: Sequence[sparse.csr_matrix],
                 is_filled: NDArray[np.bool_] | None) -> sparse.csr_matrix:
    """M_s that is regular where the pixels of neighbours alone hold unknowns, (n_unknowns, n_unknowns).

    b has nothing of it: the fixed point is the same.
    """
    subdomain = of_subdomain.subdomain
    diagonal = np.zeros(subdomain.n_unknowns)
    for view, of_whole in zip(of_subdomain.views, whole, strict=True):
        diagonal += view.view.project(of_whole).diagonal()
    is_shared = np.zeros(subdomain.n_unknowns, dtype=bool)
    is_shared[:subdomain.n_field] = subdomain.multiplicity > 1
    if is_filled is not None:
        is_shared &= ~is_filled
    return sparse.csr_matrix(hessian + sparse.diags(HELD_SHARE * diagonal * is_shared))


def describe_lost_pixels(team: Team, views: Sequence[FrameViews], counts: Sequence[CellCounts]) -> str:
    """Say how many nodes a frame has taken most pixels from, where operators are singular; collective.

    ``counts`` are the pixels of cells that count in the frame. The reason, with remedies, is given on all ranks; it is
    empty where no node has lost LOST_SHARE of its pixels.
    """
    n_lost = np.zeros(2)
    for of_subdomain, now in zip(views, counts, strict=True):
        subdomain = of_subdomain.subdomain
        before = sum_pixels(subdomain, tuple(view.count_pixels() for view in of_subdomain.reference.views))
        lost = find_displaced_nodes(subdomain, sum_pixels(subdomain, now) < (1.0 - LOST_SHARE) * before)
        parts = subdomain.mesh.parts
        of_line = np.zeros(len(lost), dtype=bool)
        if parts is not None:
            nodes = subdomain.mesh.cells[parts.cells]
            of_line[nodes[nodes >= 0]] = True
        n_lost += np.sum([lost / subdomain.node_multiplicity, lost * of_line / subdomain.node_multiplicity], axis=1)
    n_nodes, n_beside = np.rint(team.sum(n_lost)).astype(int).tolist()
    if not n_nodes:
        return ""
    told = (f"{n_nodes} nodes have lost more than {LOST_SHARE:.0%} of the pixels that hold them, which this frame "
            "hides, or shows as something else than the reference image does")
    if n_beside:
        told += (f"; {n_beside} of them stand beside a discontinuity: its line may be off its place, correct "
                 "discontinuity.vertices")
    return f"{told}; mask what is not the specimen, or give regularization.cut_off_wavelength"


def find_held(subdomain: Subdomain, counts: CellCounts) -> NDArray[np.bool_]:
    """Find the unknowns that pixels hold, (n_field,): those that displace a node of a cell with pixels."""
    return sum_pixels(subdomain, counts) > 0


def sum_pixels(subdomain: Subdomain, counts: CellCounts) -> NDArray[np.float64]:
    """Sum the pixels that see each unknown, (n_field,): those of the cells about the nodes that it displaces.

    They are weighted by how far the unknown displaces each node.
    """
    mesh = subdomain.mesh
    n_pixels = np.sum(counts, axis=0)
    of_corners = np.repeat(n_pixels, np.diff(mesh.offsets))
    of_nodes = np.bincount(mesh.connectivity, weights=of_corners, minlength=mesh.n_nodes)
    return np.asarray(abs(subdomain.kinematics.tangent).T @ np.repeat(of_nodes, mesh.dim))


def find_displaced_nodes(subdomain: Subdomain, unknowns: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Find the nodes, (n_nodes,), that some unknowns of the field, (n_field,), displace."""
    is_displaced = abs(subdomain.kinematics.tangent) @ unknowns.astype(float) > 0
    return np.asarray(is_displaced.reshape(subdomain.mesh.nodes.shape).any(axis=1))


def find_free_unknowns(team: Team, subdomains: Sequence[Subdomain], unseen: Sequence[NDArray[np.bool_]]) -> set[int]:
    """Find the unknowns that no pixel holds in any subdomain; collective.

    ``unseen``, (n_field,), are those without pixels in each owned subdomain. They are found on all ranks, by their
    numbers in the whole problem.
    """
    copies = [copy for s, is_unseen in zip(subdomains, unseen, strict=True)
              for copy in zip(s.kinematics.numbers[is_unseen].tolist(), s.multiplicity[is_unseen].tolist(),
                              strict=True)]
    gathered = team.gather_lists(copies)
    n_copies = Counter(number for number, _ in gathered)
    # Held in none of the subdomains that share it.
    return {number for number, multiplicity in gathered if n_copies[number] == multiplicity}
