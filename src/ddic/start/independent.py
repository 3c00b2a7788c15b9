"""Independent unregularized FE-DIC on each subdomain: the last stage of the start [BP17, Fig. 5]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ddic.errors import ConvergenceError, SingularSubdomainError
from ddic.functionals.grey_statistics import GreyCorrection
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.problem.assembly import SINGULAR, Hessians
from ddic.problem.moved_gradients import is_deformation_large
from ddic.problem.residual_model import ResidualModel
from ddic.problem.views import FrameViews
from ddic.solvers.correction_size import Tolerances
from ddic.solvers.gauss_newton import Progress, gauss_newton, stay_silent
from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.monolithic import MonolithicStep

TOLERANCES = Tolerances(relative=1e-3, rms=1e-2, max_iterations=10, largest=np.inf)
"""Looser than any measurement's, which goes on from there."""


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
    """Run FE-DIC on every owned subdomain by itself, by its own camera; collective.

    A subdomain whose M_s is singular or that does not converge keeps its q.

    Parameters
    ----------
    team : Team
        All ranks.
    views : sequence of FrameViews
        Owned subdomains in the frame.
    hessians : sequence of list of (n_dofs, n_dofs) csr_matrix
        M of each view, on displacements of nodes in its image.
    q : sequence of (n_field,) array
        Start of each, the set-up of its camera still.
    correction : GreyCorrection
        Of grey levels.
    clock : PhaseClock
        Told how far it is.

    Returns
    -------
    IndependentFields
        Fields, and who kept what it had.
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
                model = ResidualModel(Team.alone(), [of_subdomain], correction, follows=follows)
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
        solution = gauss_newton(model, [q], MonolithicStep(system, operator), TOLERANCES,
                                Progress(PhaseClock(), stay_silent))
    finally:
        operator.destroy()
    return solution.q[0]
