"""What the residual's noise leaves in the field: one draw of it, through the linear step of the measurement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ddic.errors import ConvergenceError, as_collective
from ddic.functionals.moved_gradient import map_hessians
from ddic.functionals.view import FrameView
from ddic.problem.residual_model import Evaluation, ResidualModel
from ddic.problem.views import FrameViews
from ddic.solvers.correction_size import CorrectionSize
from ddic.solvers.gauss_newton import Solution
from ddic.solvers.linear_step import LinearStep

Array = NDArray[np.float64]

SHARE_OF_NOISE = 0.2
"""RMS of corrections that do not become smaller, relative to the noise of the field, up to which it counts as found. A
larger share adds to that noise."""


def draw_noise(model: ResidualModel, evaluation: Evaluation, q: Sequence[Array], step: LinearStep) -> CorrectionSize:
    """Draw the error that white noise as strong as the residual leaves in a field; collective.

    Noise of variance s^2 gives b the covariance s^2 M, cell by cell, hence the field that of s^2 A^-1 M A^-1.

    Parameters
    ----------
    model : ResidualModel
        The pixels that count.
    evaluation : Evaluation
        At q.
    q : sequence of (n_unknowns,) array
        Unknowns of each owned subdomain.
    step : LinearStep
        Of the same operators.

    Returns
    -------
    CorrectionSize
        How large the error is, over nodes: pixels. The same on any number of ranks.
    """
    def draw() -> list[Array]:
        return [np.sum([_draw_forces(of_subdomain, view, evaluation.grey[view.camera].residual_std, q_s, model.follows)
                        for view in of_subdomain.views], axis=0)
                for of_subdomain, q_s in zip(model.views, q, strict=True)]

    forces = model.team.together(draw)
    at_rest = [np.zeros_like(b_s) for b_s in forces]
    return model.measure_correction(step.solve(at_rest, forces, None).dq, at_rest)


def accept_noise(model: ResidualModel, evaluation: Evaluation, solution: Solution, step: LinearStep) -> Solution:
    """Accept a field whose corrections do not become smaller, if they are far below its noise; collective.

    Images of much noise, whose gradients are half noise too, never come to rest.

    Parameters
    ----------
    model : ResidualModel
        The pixels that count.
    evaluation : Evaluation
        At the field.
    solution : Solution
        That did not converge.
    step : LinearStep
        Of the same operators.

    Returns
    -------
    Solution
        With the reason.

    Raises
    ------
    ConvergenceError
        On all ranks, where corrections are more than noise.
    """
    noise = draw_noise(model, evaluation, solution.q, step)
    last = solution.records[-1].size
    if not (last.rms <= SHARE_OF_NOISE * noise.rms and last.largest <= noise.largest):
        raise as_collective(ConvergenceError(solution.stop))
    stop = (f"stopped at RMS dq = {last.rms:.1e} px, largest dq = {last.largest:.1e} px, which do not become smaller: "
            f"a residual of {evaluation.grey[0].residual_std:.1f} grey levels leaves an error of {noise.rms:.1e} px "
            "RMS in the field")
    return replace(solution, stop=stop, converged=True)


def _draw_forces(of_subdomain: FrameViews, view: FrameView, deviation: float, q: Array, follows: bool) -> Array:
    """What the noise of a camera's pixels adds to b."""
    shown = view.with_moved_gradient(q).view if follows else view.view
    correlation = shown.correlation
    hessians = correlation.compute_cell_hessians()
    if correlation.inverse_deformations is not None:
        hessians = map_hessians(correlation.inverse_deformations, hessians)
    values, vectors = np.linalg.eigh(hessians)
    # By the cell's number, so that it does not matter which rank draws.
    drawn = np.stack([np.random.default_rng([view.camera, int(number)]).standard_normal(values.shape[1])
                      for number in of_subdomain.subdomain.cell_ids])
    of_cells = np.einsum("cij,cj->ci", vectors, np.sqrt(np.maximum(values, 0.0)) * drawn)
    on_nodes = np.zeros(correlation.mesh.n_dofs)
    np.add.at(on_nodes, correlation.interpolation.cell_dofs, deviation * of_cells)
    return np.asarray(shown.weight * shown.kinematics.project_vector(on_nodes))
