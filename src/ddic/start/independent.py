"""Independent unregularized FE-DIC on each subdomain: the last stage of the start [BP17, Fig. 5].

And R-DIC of a few cells by one rank alone, whatever the case's solver is: levels of the pyramid, strips along a line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.errors import ConvergenceError, SingularSubdomainError
from ddic.functionals.correlation import read_correlation
from ddic.functionals.grey_statistics import GreyCorrection
from ddic.functionals.regularization import (
    Material,
    controlled_stiffness,
    find_cut_off_weight,
    measure_gap_energies,
    measure_texture_energies,
)
from ddic.functionals.view import FrameView, View
from ddic.images.sub_image import DeformedSubImage, MaskedSource
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.partition.build_subdomains import build_subdomains
from ddic.partition.subdomain import Subdomain
from ddic.problem.assembly import SINGULAR, Hessians
from ddic.problem.residual_model import ResidualModel, is_deformation_large
from ddic.problem.views import FrameViews, ReferenceViews
from ddic.solvers.correction_size import Tolerances
from ddic.solvers.gauss_newton import Progress, gauss_newton, stay_silent
from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.local_system import LocalSystem, MonolithicStep
from ddic.start.coarse_displacement import LevelMesh

TOLERANCES = Tolerances(relative=1e-3, rms=1e-2, max_iterations=10, largest=np.inf)
"""Looser than any measurement's, which goes on from there."""

FREE_EDGE = 0.03
"""Weight of the equilibrium of the cells' edge relative to their inside. Cells at the edge may hold a few pixels only,
which do not determine all of their nodes; a thousandth of the energy does, and is nothing where there is texture. A
larger value stiffens the edge."""

SINGULAR_ALONE = 1e-10
"""Lowest eigenvalue of a usable operator, relative to the mean diagonal of M. A larger value refuses more of them."""


@dataclass(frozen=True)
class IndependentFields:
    """What the subdomains found by themselves.

    Attributes
    ----------
    q : list of (n_field,) array
        Field of each owned subdomain, the set-up of its camera still.
    kept : list of int
        Owned subdomains that kept what they had, by number.
    """

    q: list[NDArray[np.float64]]
    kept: list[int]


def measure_independently(team: Team, views: Sequence[FrameViews], hessians: Sequence[Hessians],
                          q: Sequence[NDArray[np.float64]], correction: GreyCorrection,
                          clock: PhaseClock) -> IndependentFields:
    """Run FE-DIC, M dq = b of Eq. 6 of [BP17], on every owned subdomain by itself, by its own camera; collective.

    A subdomain whose M_s is singular or that does not converge keeps its q, with which it starts, the set-up of its
    camera still. ``hessians`` are M of each view, on displacements of nodes in its image.
    """
    alone = [of_subdomain.alone() for of_subdomain in views]
    follows = is_deformation_large(team, alone, q)
    if follows:
        hessians = team.together(lambda: [[of_subdomain.views[0].view.with_moved_gradient(q_s).assemble_hessian()]
                                          for of_subdomain, q_s in zip(alone, q, strict=True)])
    projected = [of_subdomain.reference.project(m[:1]) for of_subdomain, m in zip(alone, hessians, strict=True)]
    thresholds = _find_thresholds(team, alone, projected)

    def measure() -> IndependentFields:
        fields, kept = [], []
        for of_subdomain, hessian, q_s in clock.note_each(list(zip(alone, projected, q, strict=True))):
            threshold = thresholds[of_subdomain.subdomain.camera]
            try:
                model = ResidualModel(Team.alone(), [of_subdomain], correction, follows=follows, keeps_windows=True)
                fields.append(_measure_alone(model, hessian, q_s, threshold))
            except (SingularSubdomainError, ConvergenceError):
                fields.append(q_s)
                kept.append(of_subdomain.subdomain.index)
        return IndependentFields(fields, kept)

    return team.together(measure)


def _find_thresholds(team: Team, alone: Sequence[FrameViews], hessians: Sequence[sparse.csr_matrix],
                     ) -> dict[int, float]:
    """Eigenvalue below which M_s counts as singular, by camera: of the mean diagonal of all its subdomains."""
    sums: dict[int, NDArray[np.float64]] = {}
    mine = [(of_subdomain.subdomain.camera, np.array([hessian.diagonal().sum(), hessian.shape[0]]))
            for of_subdomain, hessian in zip(alone, hessians, strict=True)]
    for camera, of_subdomain in team.gather_lists(mine):
        sums[camera] = sums.get(camera, np.zeros(2)) + of_subdomain
    return {camera: SINGULAR * float(total / n_unknowns) for camera, (total, n_unknowns) in sums.items()}


def _measure_alone(model: ResidualModel, hessian: sparse.csr_matrix, q: NDArray[np.float64],
                   threshold: float) -> NDArray[np.float64]:
    system = LocalSystem(model.views[0].subdomain, hessian, None, np.zeros(0), 0.0)
    operator = LocalOperator(hessian, smallest_eigenvalue=threshold, where="independent start")
    try:
        step = MonolithicStep(system, operator)
        return gauss_newton(model, [q], step, TOLERANCES, Progress(PhaseClock(), stay_silent)).q[0]
    finally:
        operator.destroy()


@dataclass(frozen=True, eq=False)
class Images:
    """An image pair, and how it is read.

    Attributes
    ----------
    reference, deformed : MaskedSource
        The images; their pixels are the unit of length.
    active : (rows, columns) array of uint8
        1 on the pixels of the reference image that count.
    degree : int
        Of the spline between pixels.
    correction : GreyCorrection
        Of grey levels.
    """

    reference: MaskedSource
    deformed: MaskedSource
    active: NDArray[np.uint8]
    degree: int
    correction: GreyCorrection


def correlate_alone(images: Images, cells: LevelMesh, cut_off: float, tolerances: Tolerances,
                    starts: Sequence[NDArray[np.float64]], where: str) -> NDArray[np.float64]:
    """Correlate some cells from the best of some starts, with a cut-off wavelength; pixels of the images.

    Of ``starts``, at least one displacement of the nodes, (n_dofs,), that of least residual is taken. ``where`` says
    what is measured, for messages. Raises ConvergenceError where Gauss-Newton does not converge, SingularSubdomainError
    where the pixels do not determine the displacement.
    """
    problem = _read(images, cells)
    kinematics = problem.subdomain.kinematics
    candidates = [kinematics.fit(start) for start in starts]
    q = candidates[0]
    if len(candidates) > 1:
        q = min(candidates, key=lambda candidate: _residual_rms(problem.model, candidate))
    model = problem.model.with_large_gradients([q])
    view = problem.view.with_moved_gradient(q) if model.follows else problem.view
    system = _regularize(replace(problem, view=view), cut_off)
    smallest_eigenvalue = SINGULAR_ALONE * float(system.hessian.diagonal().mean())
    operator = LocalOperator(system.operator, smallest_eigenvalue=smallest_eigenvalue, where=where)
    try:
        step = MonolithicStep(system, operator)
        found = gauss_newton(model, [q], step, tolerances, Progress(PhaseClock(), stay_silent)).q[0]
    finally:
        operator.destroy()
    return kinematics.displacement(found)


@dataclass(frozen=True)
class _Problem:
    """Cells with their pixels, one subdomain that is all of them."""

    view: View
    subdomain: Subdomain
    model: ResidualModel
    row_weights: NDArray[np.float64]


def _read(images: Images, cells: LevelMesh) -> _Problem:
    everywhere = np.ones(cells.kinematics.n_unknowns, dtype=bool)
    one_domain = np.zeros(cells.mesh.n_cells, dtype=np.int64)
    subdomain = build_subdomains(cells.kinematics, one_domain, everywhere, cells.interior)[0]
    row_weights = np.where(cells.kinematics.controlled(~cells.on_edge), 1.0, FREE_EDGE)
    correlation = read_correlation(cells.mesh, images.reference, images.degree)
    seen = images.active[images.reference.extent.locate(correlation.reference.window)].copy()
    if correlation.reference.usable is not None:
        seen &= correlation.reference.usable
    # Pixels that are not active lie beside the mesh: neighbours' slopes are taken from them as they are.
    view = View(replace(correlation, reference=replace(correlation.reference, usable=seen)), subdomain.kinematics)
    frame_view = FrameView(view, DeformedSubImage(images.deformed, images.degree))
    views = FrameViews(ReferenceViews(subdomain, (view,)), (frame_view,))
    return _Problem(view, subdomain, ResidualModel(Team.alone(), [views], images.correction), row_weights)


def _regularize(problem: _Problem, cut_off: float) -> LocalSystem:
    """M and Kbar of the cells, with the weight of a cut-off wavelength; the edge counts little."""
    subdomain, of_nodes = problem.subdomain, problem.view.assemble_hessian()
    mesh, interior = subdomain.mesh, subdomain.interior
    kbar = controlled_stiffness(subdomain.kinematics, Material(), problem.row_weights)
    eta = 0.0
    if interior.any():
        texture = measure_texture_energies(mesh.nodes, of_nodes, interior, cut_off)
        gap = measure_gap_energies(mesh, Material(), interior, cut_off)
        eta = find_cut_off_weight(texture, gap)
    return LocalSystem(subdomain, problem.view.project(of_nodes), kbar, np.ones(len(problem.row_weights)), eta)


def _residual_rms(model: ResidualModel, q: NDArray[np.float64]) -> float:
    """Root mean square of a start's residual, grey levels; infinite where it leaves no pixel."""
    try:
        return model.evaluate([q]).grey[0].residual_rms
    except ConvergenceError:
        return np.inf
