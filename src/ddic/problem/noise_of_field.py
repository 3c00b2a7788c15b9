"""Corrections that do not become smaller, but are far below the noise of the field."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ddic.partition.subdomain import Subdomain
from ddic.problem.held_unknowns import find_free_unknowns, find_held
from ddic.problem.residual_model import Evaluation, ResidualModel
from ddic.problem.weighted_problem import WeightedProblem
from ddic.solvers.gauss_newton import PATIENCE, Solution
from ddic.solvers.noise_floor import estimate_noise_by_steps

SHARE_OF_NOISE = 0.2
"""RMS of corrections that do not become smaller, relative to the noise of the field, up to which it counts as found. A
larger share adds to that noise."""

LARGEST_OF_NOISE = 4.0
"""The same of the largest correction of a node: nodes at a corner have several times the noise of others."""


def accept_noise(problem: WeightedProblem, used: ResidualModel, solution: Solution, n_last: int) -> Solution:
    """Accept a field whose corrections do not become smaller, if they are far below its noise; collective.

    Images of much noise, whose gradients are half noise too, never come to rest.

    Parameters
    ----------
    problem : WeightedProblem
        The linear step.
    used : ResidualModel
        The pixels that count.
    solution : Solution
        That did not converge.
    n_last : int
        Its iterations since anything else changed.

    Returns
    -------
    Solution
        With the reason; the same where corrections are more than noise.
    """
    if n_last <= PATIENCE:
        # Fewer were asked for: nobody knows yet.
        return solution
    # Of the pixels that count: what hides others is no noise.
    evaluation = used.evaluate(solution.q)
    deviation = evaluation.grey[0].residual_std
    # Of a vector, as corrections are; the residual has the noise of both images.
    counted = [~is_unmeasured for is_unmeasured in find_unmeasured_nodes(problem, evaluation)]
    noise = np.sqrt(2.0) * estimate_noise_by_steps(problem.team, problem.solver.assembly.systems, problem.solver.step,
                                                   deviation / np.sqrt(2.0), counted)
    last = solution.records[-1].size
    if not (last.rms <= SHARE_OF_NOISE * noise and last.largest <= LARGEST_OF_NOISE * noise):
        return solution
    stop = (f"stopped at RMS dq = {last.rms:.1e} px, largest dq = {last.largest:.1e} px, which do not become smaller: "
            f"a residual of {deviation:.1f} grey levels leaves an error of {noise:.1e} px RMS in the field")
    return replace(solution, stop=stop, converged=True)


def find_unmeasured_nodes(problem: WeightedProblem, evaluation: Evaluation) -> list[NDArray[np.bool_]]:
    """Find the nodes that neither pixels nor mechanics hold; collective.

    Parameters
    ----------
    problem : WeightedProblem
        Of the reference.
    evaluation : Evaluation
        Of a frame, with the pixels that count.

    Returns
    -------
    list of (n_nodes,) bool array
        Of each owned subdomain.
    """
    subdomains = problem.reference.subdomains
    if problem.reference.inputs.case.regularization is not None:
        return [np.zeros(subdomain.mesh.n_nodes, dtype=bool) for subdomain in subdomains]
    unseen = [~find_held(subdomain, tuple(residual.cell_sums.n_pixels.astype(np.int64) for residual in of_views))
              for subdomain, of_views in zip(subdomains, evaluation.residuals, strict=True)]
    free = np.array(sorted(find_free_unknowns(problem.team, subdomains, unseen)), dtype=np.int64)
    return [_find_moved_nodes(subdomain, free) for subdomain in subdomains]


def _find_moved_nodes(subdomain: Subdomain, numbers: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Nodes that unknowns displace, given by their numbers, (n_nodes,)."""
    columns = np.isin(subdomain.kinematics.numbers, numbers)
    moved = np.asarray(abs(subdomain.kinematics.tangent)[:, columns].sum(axis=1)).ravel() > 0
    return np.asarray(moved.reshape(subdomain.mesh.nodes.shape).any(axis=1))
