"""Independent unregularized FE-DIC on each subdomain: the last stage of the start [BP17, Fig. 5].

And R-DIC of a few cells by one rank alone, whatever the case's solver is: levels of the pyramid, strips along a line.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.arrays import Array
from ddic.errors import ConvergenceError, SingularSubdomainError
from ddic.functionals.correlation import read_correlation
from ddic.functionals.grey_statistics import GreyCorrection
from ddic.functionals.regularization import Material, controlled_stiffness, measure_gap_energies
from ddic.functionals.view import FrameView, View
from ddic.images.sub_image import DeformedSubImage, MaskedSource
from ddic.images.window import Window
from ddic.parallel.field import ByView, Field
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.partition.sharing import build_subdomains
from ddic.partition.subdomain import Subdomain
from ddic.problem.assembly import SINGULAR, find_eta, weigh_rows
from ddic.problem.reference_problem import Hessians, hold_set_ups_still, project_hessians
from ddic.problem.region_mesh import ProbeWaves
from ddic.problem.residual_model import ResidualModel, is_deformation_large
from ddic.solvers.correction_size import Tolerances
from ddic.solvers.gauss_newton import Progress, Report, gauss_newton, stay_silent
from ddic.solvers.local_system import LocalOperator, LocalSystem, MonolithicStep
from ddic.start.coarse_displacement import LevelMesh

TOLERANCES = Tolerances(relative=1e-3, rms=1e-2, max_iterations=10, largest=np.inf)
"""Looser than any measurement's, which goes on from there."""

FREE_EDGE = 0.03
"""Weight of the equilibrium of the cells' edge relative to their inside. Cells at the edge may hold a few pixels only,
which do not determine all of their nodes; a thousandth of the energy does, and is nothing where there is texture. A
larger value stiffens the edge."""

SINGULAR_ALONE = 1e-10
"""Lowest eigenvalue of a usable operator, relative to the mean diagonal of M. A larger value refuses more of them."""


def measure_independently(q: Field, views: ByView[FrameView], hessians: Hessians, correction: GreyCorrection,
                          clock: PhaseClock) -> tuple[Field, list[int]]:
    """Run FE-DIC, M dq = b of Eq. 6 of [BP17], on every owned subdomain by itself, by its own camera; collective.

    ``q`` are the unknowns of fields to start from, (n_field,), the set-ups of all cameras still; so are those found. A
    subdomain whose M_s is singular or that does not converge keeps what it had: the numbers of these come as well.
    ``hessians`` are M of each view, on displacements of nodes in its image.
    """
    team = q.team
    still, alone = hold_set_ups_still(q.subdomains, views)
    # Each is the first camera of a problem of its own.
    alone = alone.map(lambda view: replace(view, camera=0))
    of_own = ByView([own] for own, *_ in hessians)
    follows = is_deformation_large(team, alone, q)
    if follows:
        of_own = team.together(lambda: alone.map(
            lambda view, q_s: view.with_moved_gradient(q_s).assemble_hessian(), alone.fill(q)))
    projected = project_hessians(alone, of_own)
    thresholds = _find_thresholds(team, still, projected)

    def measure() -> tuple[Field, list[int]]:
        fields, kept = [], []
        for subdomain, view, hessian, q_s in clock.note_each(list(zip(still, alone, projected, q, strict=True))):
            model = ResidualModel(Team.alone(), [subdomain], ByView([view]), correction, follows=follows,
                                  keeps_windows=True)
            system = LocalSystem(subdomain, hessian, None, np.zeros(0), 0.0)
            try:
                fields.append(_iterate(model, system, thresholds[subdomain.camera], q_s, TOLERANCES,
                                       "independent start"))
            except (SingularSubdomainError, ConvergenceError):
                fields.append(q_s)
                kept.append(subdomain.index)
        return q.with_parts(fields), kept

    return team.together(measure)


def _find_thresholds(team: Team, subdomains: Sequence[Subdomain],
                     hessians: Sequence[sparse.csr_matrix]) -> dict[int, float]:
    """Eigenvalue below which M_s counts as singular, by camera: of the mean diagonal of all its subdomains."""
    sums: dict[int, Array] = {}
    mine = [(subdomain.camera, np.array([hessian.diagonal().sum(), hessian.shape[0]]))
            for subdomain, hessian in zip(subdomains, hessians, strict=True)]
    for camera, of_subdomain in team.gather_lists(mine):
        sums[camera] = sums.get(camera, np.zeros(2)) + of_subdomain
    return {camera: SINGULAR * float(total / n_unknowns) for camera, (total, n_unknowns) in sums.items()}


def _iterate(model: ResidualModel, system: LocalSystem, smallest_eigenvalue: float, start: Array,
             tolerances: Tolerances, where: str, report: Report = stay_silent) -> Array:
    """Gauss-Newton on one domain: the unknowns of its only subdomain."""
    operator = LocalOperator(system.operator, smallest_eigenvalue=smallest_eigenvalue, where=where)
    try:
        return gauss_newton(model, _as_field(model, start), MonolithicStep(system, operator), tolerances,
                            Progress(PhaseClock(), report)).q[0]
    except ConvergenceError as error:
        # What was found on the way is no result, and holds what cannot be sent to other ranks.
        error.last = None
        raise
    finally:
        operator.destroy()


def _as_field(model: ResidualModel, unknowns: Array) -> Field:
    return Field(model.team, model.subdomains, [unknowns])


@dataclass(frozen=True, eq=False)
class Images:
    """An image pair, and how it is read.

    Attributes
    ----------
    reference, deformed : MaskedSource
        The images; their pixels are the unit of length.
    active : array of a part's shape
        1 on the pixels of that part of the reference image that count, 0 on others.
    degree : int
        Of the spline between pixels.
    correction : GreyCorrection
        Of grey levels.
    origin : tuple of int, optional
        The first pixel of that part. Pixels outside of it do not count.
    """

    reference: MaskedSource
    deformed: MaskedSource
    active: NDArray[np.uint8]
    degree: int
    correction: GreyCorrection
    origin: tuple[int, ...] | None = None

    def find_active(self, window: Window) -> NDArray[np.uint8]:
        """Tell which pixels of a window count, 1, and which do not, 0."""
        part = Window.of_size(*self.active.shape[::-1])
        if self.origin is not None:
            part = Window.between(self.origin, np.add(self.origin, part.sizes))
        common = window.intersection(part)
        found = np.zeros(window.shape, np.uint8)
        found[window.locate(common)] = self.active[part.locate(common)]
        return found


def correlate_alone(images: Images, cells: LevelMesh, cut_off: float, tolerances: Tolerances,
                    starts: Sequence[Array], where: str, report: Report = stay_silent) -> Array:
    """Correlate some cells from the best of some starts, with a cut-off wavelength; pixels of the images.

    Of ``starts``, at least one displacement of the nodes, (n_dofs,), that of least residual is taken. ``where`` says
    what is measured, for messages; ``report`` is told of every iteration. Raises ConvergenceError where Gauss-Newton
    does not converge, SingularSubdomainError where the pixels do not determine the displacement.
    """
    model = _read(images, cells)
    (subdomain,), ((view,),) = model.subdomains, model.views
    candidates = [subdomain.kinematics.fit(start) for start in starts]
    q = candidates[0]
    if len(candidates) > 1:
        q = min(candidates, key=lambda candidate: _residual_rms(model, candidate))
    model = model.with_large_gradients(_as_field(model, q))
    system = _regularize(subdomain, view.with_moved_gradient(q) if model.follows else view, cut_off)
    smallest_eigenvalue = SINGULAR_ALONE * float(system.hessian.diagonal().mean())
    return subdomain.displacement(_iterate(model, system, smallest_eigenvalue, q, tolerances, where, report))


def _read(images: Images, cells: LevelMesh) -> ResidualModel:
    """The residual on one subdomain that is all cells."""
    controlled = cells.kinematics.controlled(~cells.on_edge)
    one_domain = np.zeros(cells.mesh.n_cells, dtype=np.int64)
    (subdomain,) = build_subdomains(cells.kinematics, one_domain, controlled, cells.interior)
    correlation = read_correlation(cells.mesh, images.reference, images.degree)
    seen = images.find_active(correlation.reference.window)
    if correlation.reference.usable is not None:
        seen &= correlation.reference.usable
    # Pixels that are not active lie beside the mesh: neighbours' slopes are taken from them as they are.
    view = View(replace(correlation, reference=replace(correlation.reference, usable=seen)), subdomain.kinematics)
    in_frame = view.open_frame(DeformedSubImage(images.deformed, images.degree))
    return ResidualModel(Team.alone(), [subdomain], ByView([[in_frame]]), images.correction)


def _regularize(subdomain: Subdomain, view: View, cut_off: float) -> LocalSystem:
    """M and Kbar of the cells, with the weight of a cut-off wavelength; the edge counts little."""
    of_nodes = view.assemble_hessian()
    material = Material.default(subdomain.mesh.dim)
    energies = measure_gap_energies(subdomain.mesh, material, subdomain.interior, cut_off)
    waves = ProbeWaves(cut_off, energies, material.axes)
    eta = 0.0
    if waves.is_weighable:
        eta = find_eta(Team.alone(), [subdomain], ByView([[view]]), ByView([[of_nodes]]), waves)
    of_rows = weigh_rows(subdomain.controlled, FREE_EDGE)
    kbar = controlled_stiffness(subdomain.kinematics, material, of_rows)
    return LocalSystem(subdomain, view.project(of_nodes), kbar, np.ones(len(of_rows)), eta)


def _residual_rms(model: ResidualModel, q: Array) -> float:
    """Root mean square of a start's residual, grey levels; infinite where it leaves no pixel."""
    try:
        return model.evaluate(_as_field(model, q)).grey[0].residual_rms
    except ConvergenceError:
        return np.inf
