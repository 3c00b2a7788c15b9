"""R-DIC of a few cells by one rank alone, whatever the case's solver is: levels of the pyramid, strips along a line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ddic.errors import ConvergenceError
from ddic.functionals.elasticity import Material
from ddic.functionals.equilibrium_gap import (
    controlled_stiffness,
    find_cut_off_weight,
    measure_gap_energies,
    measure_texture_energies,
)
from ddic.functionals.grey_statistics import GreyCorrection
from ddic.functionals.read_correlation import read_correlation
from ddic.functionals.view import FrameView, View
from ddic.images.sub_image import DeformedSubImage, MaskedSource
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.partition.build_subdomains import build_subdomains
from ddic.partition.subdomain import Subdomain
from ddic.problem.residual_model import ResidualModel
from ddic.problem.views import FrameViews, ReferenceViews
from ddic.solvers.correction_size import Tolerances
from ddic.solvers.gauss_newton import Progress, gauss_newton, stay_silent
from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.local_system import LocalSystem
from ddic.solvers.monolithic import MonolithicStep
from ddic.start.level_mesh import LevelMesh

FREE_EDGE = 0.03
"""Weight of the equilibrium of the cells' edge relative to their inside. Cells at the edge may hold a few pixels only,
which do not determine all of their nodes; a thousandth of the energy does, and is nothing where there is texture. A
larger value stiffens the edge."""

SINGULAR = 1e-10
"""Lowest eigenvalue of a usable operator, relative to the mean diagonal of M. A larger value refuses more of them."""


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
    """Correlate some cells from the best of some starts, with a cut-off wavelength.

    Parameters
    ----------
    images : Images
        The pair.
    cells : LevelMesh
        What is measured, pixels of the images.
    cut_off : float
        Cut-off wavelength of the equilibrium gap, pixels.
    tolerances : Tolerances
        Of Gauss-Newton.
    starts : sequence of (n_dofs,) array
        At least one displacement of the nodes, pixels; that of least residual is taken.
    where : str
        What is measured, for messages.

    Returns
    -------
    (n_dofs,) array
        Displacement of the nodes, pixels.

    Raises
    ------
    ConvergenceError
        Where Gauss-Newton does not converge.
    SingularSubdomainError
        Where the pixels do not determine the displacement.
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
    smallest_eigenvalue = SINGULAR * float(system.hessian.diagonal().mean())
    operator = LocalOperator(system.operator, smallest_eigenvalue=smallest_eigenvalue, where=where)
    try:
        silent = Progress(PhaseClock(), stay_silent)
        solution = gauss_newton(model, [q], MonolithicStep(system, operator), tolerances, silent)
    finally:
        operator.destroy()
    return kinematics.displacement(solution.q[0])


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
