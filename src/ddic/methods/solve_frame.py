"""Gauss-Newton on one frame, with operators that fit the pixels that the frame shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ddic.errors import ConvergenceError, as_collective
from ddic.parallel.phases import Phase, PhaseClock
from ddic.problem.residual_model import ResidualModel
from ddic.problem.views import read_frame_windows
from ddic.problem.weighted_problem import WeightedProblem
from ddic.results.listener import Listener
from ddic.solvers.gauss_newton import Progress, Solution, gauss_newton

MOST_RENEWALS = 5
"""Times that operators are renewed for one frame before it is given up."""


def solve_frame(problem: WeightedProblem, model: ResidualModel, q: list[NDArray[np.float64]], listener: Listener,
                clock: PhaseClock) -> tuple[Solution, tuple[str, ...]]:
    """Iterate from a start until neither the field nor what the frame shows of it changes; collective.

    Parameters
    ----------
    problem : WeightedProblem
        Operators, renewed where the frame asks for it.
    model : ResidualModel
        Of the frame, cameras weighted.
    q : list of (n_unknowns,) array
        Start of each owned subdomain.
    listener : Listener
        Told what happens.
    clock : PhaseClock
        Of the phases.

    Returns
    -------
    solution : Solution
        Unknowns and all iterations.
    notes : tuple of str
        What was renewed.

    Raises
    ------
    ConvergenceError, SingularSubdomainError, FactorizationError
        On all ranks; the first with the last Solution.
    """
    with clock.phase(Phase.READ):
        model.team.together(lambda: read_frame_windows(model.views, q))
    model, notes = problem.hold_rotation(model.with_large_gradients(q), q)
    notes = (*notes, *problem.renew(model, q))
    for line in notes:
        listener.note(line)
    listener.problem_size(problem.size)
    solution = Solution(q, [])
    for _ in range(MOST_RENEWALS):
        progress = Progress(clock, listener.iteration, len(solution.records))
        try:
            found = gauss_newton(model, solution.q, problem.solver.step, problem.tolerances, progress)
        except ConvergenceError as error:
            error.last = _join(solution, error.last)
            raise
        solution = _join(solution, found)
        # Where the start was far off, other pixels are hidden here: that held the step back, or left a node to nothing.
        followed = model if model.follows else model.with_large_gradients(solution.q)
        model, turned = problem.hold_rotation(followed, solution.q)
        renewed = (*turned, *problem.renew(model, solution.q))
        if not renewed:
            listener.note(solution.stop)
            return solution, notes
        for line in renewed:
            listener.note(line)
        notes = (*notes, *renewed)
    raise as_collective(ConvergenceError(
        f"what the frame shows, pixels or how far they turn, still changes after {MOST_RENEWALS} solutions; look at "
        "the masks and the start, or give a longer regularization.cut_off_wavelength", solution))


def _join(before: Solution, found: Solution) -> Solution:
    """The later of two solutions of a frame, with the iterations of both."""
    return Solution(found.q, [*before.records, *found.records], found.stop)
