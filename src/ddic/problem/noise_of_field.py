"""Corrections that do not become smaller, but are far below the noise of the field."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ddic.problem.residual_model import ResidualModel
from ddic.problem.unmeasured_nodes import find_unmeasured_nodes
from ddic.problem.weighted_problem import WeightedProblem
from ddic.solvers.gauss_newton import PATIENCE, Solution
from ddic.solvers.noise_floor import estimate_noise_by_steps

SHARE_OF_NOISE = 0.2
"""RMS of corrections that do not become smaller, relative to the noise of the field, up to which it counts as found. A
larger share adds to that noise."""

LARGEST_OF_NOISE = 4.0
"""The same of the largest correction of a node: nodes at a corner have several times the noise of others."""


def accept_noise(problem: WeightedProblem, used: ResidualModel, solution: Solution) -> Solution:
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

    Returns
    -------
    Solution
        With the reason; the same where corrections are more than noise.
    """
    if problem.tolerances.max_iterations <= PATIENCE:
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
