"""A whole mesh as one subdomain, measured on a pair of images in memory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.correlation import read_correlation
from ddic.functionals.grey_statistics import GreyCorrection
from ddic.functionals.view import View
from ddic.images.sub_image import DeformedSubImage, MaskedSource
from ddic.kinematics.nodal import NodalRegion
from ddic.mesh.mesh import Mesh
from ddic.parallel.field import ByView
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.partition.sharing import build_subdomains
from ddic.problem.residual_model import ResidualModel
from ddic.solvers.correction_size import Tolerances
from ddic.solvers.gauss_newton import Progress, Solution, gauss_newton
from ddic.solvers.local_system import LocalOperator, LocalSystem, MonolithicStep
from support.fields import field_of


def model_of(reference: MaskedSource, deformed: MaskedSource, mesh: Mesh, correction: GreyCorrection = "none",
             degree: int = 3) -> ResidualModel:
    """The residual of the pair on one rank."""
    controlled = np.zeros(mesh.n_dofs, dtype=bool)
    subdomain = build_subdomains(NodalRegion(mesh), np.zeros(mesh.n_cells, np.int64), controlled)[0]
    view = View(read_correlation(mesh, reference, degree), subdomain.kinematics)
    frame_view = view.open_frame(DeformedSubImage(deformed, degree))
    return ResidualModel(Team.alone(), [subdomain], ByView([[frame_view]]), correction)


def system_of(model: ResidualModel) -> LocalSystem:
    """M without regularization."""
    (view,) = model.views[0]
    return LocalSystem(model.subdomains[0], view.project(view.assemble_hessian()), None, np.zeros(0), 0.0)


def measure_alone(model: ResidualModel, *, q: NDArray[np.float64] | None = None,
                  tolerances: Tolerances | None = None) -> Solution:
    """FE-DIC without regularization from q (zero)."""
    system = system_of(model)
    threshold = 1e-9 * float(system.hessian.diagonal().mean())
    operator = LocalOperator(system.hessian, smallest_eigenvalue=threshold, where="test")
    start = field_of(model, [np.zeros(system.subdomain.n_unknowns) if q is None else q])
    try:
        return gauss_newton(model, start, MonolithicStep(system, operator), tolerances or Tolerances(),
                            Progress(PhaseClock()))
    finally:
        operator.destroy()
