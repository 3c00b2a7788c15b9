"""The field of a frame and what it was found from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ddic.errors import ConvergenceError
from ddic.problem.grey_choice import ORDER
from ddic.problem.held_back import SeenStart
from ddic.problem.residual_model import ResidualModel
from ddic.problem.see_frame import SeenFrame, see_frame
from ddic.problem.weighted_problem import WeightedProblem
from ddic.solvers.dual.continuity import ContinuousField, average_copies
from ddic.solvers.gauss_newton import Progress, Revise, Solution, run_gauss_newton

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SolvedFrame:
    """The field of a frame, and what it was found from.

    Attributes
    ----------
    field : ContinuousField
        Unknowns, one value for the copies of each (Eq. 41 of [BP17]).
    solution : Solution
        Unknowns before that, and all iterations.
    seen : SeenFrame
        All pixels that the frame shows, and what of them was excluded.
    used : ResidualModel
        Of the others.
    notes : tuple of str
        What was renewed, and which linear step was replaced.
    is_evaluated : bool
        Whether what is seen was evaluated at the field.
    """

    field: ContinuousField
    solution: Solution
    seen: SeenFrame
    used: ResidualModel
    notes: tuple[str, ...]
    is_evaluated: bool = True


def begin_frame(seen: SeenFrame, used: ResidualModel, q: Sequence[Array], notes: tuple[str, ...]) -> SolvedFrame:
    """Take a start for a field.

    Parameters
    ----------
    seen : SeenFrame
        At the start.
    used : ResidualModel
        The pixels that count.
    q : sequence of (n_unknowns,) array
        The start, of each owned subdomain.
    notes : tuple of str
        What was renewed.

    Returns
    -------
    SolvedFrame
        Without iterations.
    """
    # Copies of an unknown may still differ: they are averaged after the first iterations, before anybody looks at them.
    field = ContinuousField(list(q), 0.0)
    return SolvedFrame(field, Solution(list(q), []), seen, used, notes, is_evaluated=False)


def solve_further(problem: WeightedProblem, solved: SolvedFrame, progress: Progress,
                  revise: Revise | None = None) -> SolvedFrame:
    """Go on with Gauss-Newton, with the same operators; collective.

    Parameters
    ----------
    problem : WeightedProblem
        The linear step.
    solved : SolvedFrame
        Where to go on from.
    progress : Progress
        Where to write.
    revise : callable, optional
        Asked after every correction for another model of the frame; collective. Never, by default.

    Returns
    -------
    SolvedFrame
        Converged or not, with all iterations.

    Raises
    ------
    ConvergenceError
        On all ranks, where an iteration fails; with the last SolvedFrame.
    """
    before = solved.solution

    def join(found: Solution) -> SolvedFrame:
        joined = replace(found, records=[*before.records, *found.records])
        field = average_copies(problem.team, problem.reference.subdomains, joined.q)
        notes = (*solved.notes, *problem.solver.release_notes())
        return replace(solved, field=field, solution=joined, notes=notes, is_evaluated=False)

    try:
        return join(run_gauss_newton(solved.used, before.q, problem.solver.step, problem.tolerances, progress, revise))
    except ConvergenceError as error:
        error.last = join(error.last)
        raise


def see_solved_frame(problem: WeightedProblem, solved: SolvedFrame, start: SeenStart | None,
                     as_read: ResidualModel | None = None) -> SeenFrame:
    """See the frame at a field; collective.

    Parameters
    ----------
    problem : WeightedProblem
        Of the frame.
    solved : SolvedFrame
        The field.
    start : SeenStart or None
        From which mechanics may hold cells back; None where they do not.
    as_read : ResidualModel, optional
        The same pixels, of which nothing has been said of brightness: a start that was off may have called for more
        correction than the field does. By default what was chosen is never taken back.

    Returns
    -------
    SeenFrame
        At the field.

    Raises
    ------
    ConvergenceError
        On all ranks, where the frame does not show the specimen there; with the SolvedFrame.
    """
    case, before, q = problem.reference.inputs.case, solved.seen.whole, solved.field.q
    try:
        if as_read is not None and before.correction != as_read.correction and not before.blurs:
            seen = see_frame(case, as_read, q, problem.slopes, start=start)
            if ORDER.index(seen.whole.correction) < ORDER.index(before.correction):
                return seen
        return see_frame(case, before, q, problem.slopes, start=start)
    except ConvergenceError as error:
        error.last = solved
        raise
