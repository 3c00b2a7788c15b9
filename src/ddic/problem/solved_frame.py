"""The field of a frame, found with what was seen of it last."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ddic.errors import ConvergenceError
from ddic.problem.grey_choice import ORDER
from ddic.problem.residual_model import ResidualModel
from ddic.problem.see_frame import SeenFrame, see_frame
from ddic.problem.slow_nodes import confine_to_slow_nodes, estimate_node_deviations
from ddic.problem.weighted_problem import WeightedProblem
from ddic.solvers.anderson import AndersonMixing
from ddic.solvers.correction_size import CorrectionSize, Tolerances
from ddic.solvers.dual.continuity import ContinuousField, average_copies
from ddic.solvers.gauss_newton import Correction, Course, Model, Pause, Progress, Solution, run_gauss_newton

Array = NDArray[np.float64]

ROUGHLY = 0.01
"""Correction of most nodes, pixels, from which on the field is good enough to look at the frame. A larger value looks
earlier, and takes what is still to be found for something foreign."""

MOST_MOVING, MOST_SLOW = 0.2, 0.05
"""Share of the nodes that may still move where a frame is looked at, and that may where only these are iterated on."""

MOST_TIMES = 10
"""Times that slow nodes are iterated alone before the others are taken along again."""


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
    """Take a start for a field."""
    # Copies of an unknown may still differ: they are averaged after the first iterations, before anybody looks at them.
    field = ContinuousField(list(q), 0.0)
    return SolvedFrame(field, Solution(list(q), []), seen, used, notes, is_evaluated=False)


def solve_further(problem: WeightedProblem, solved: SolvedFrame, progress: Progress, *,
                  roughly: bool) -> SolvedFrame:
    """Go on with Gauss-Newton, with the same operators; collective.

    Where all but a few nodes are found, these are iterated alone, and a pass over all pixels checks the others.

    Parameters
    ----------
    problem : WeightedProblem
        The linear step.
    solved : SolvedFrame
        Where to go on from.
    progress : Progress
        Where to write.
    roughly : bool
        Whether to pause as soon as few nodes move by more than ROUGHLY.

    Returns
    -------
    SolvedFrame
        Converged or not, with all iterations.

    Raises
    ------
    ConvergenceError
        On all ranks, where an iteration fails; with the last SolvedFrame.
    """
    systems, tolerances, used = problem.solver.assembly.systems, problem.tolerances, solved.used
    roughly &= tolerances.rms < ROUGHLY
    if roughly:
        tolerances = replace(tolerances, relative=0.0, rms=0.0, largest=ROUGHLY)
    elif solved.seen.typical[0].is_alike:
        # Of a rough field the residual is more than noise, and of unlike images it is none.
        used = replace(used, deviations=estimate_node_deviations(used, systems, solved.seen.typical[0].noise))
    # A rough field was a part of the way.
    n_spent = len(solved.solution.records) if solved.solution.paused is not None else 0
    if n_spent >= tolerances.max_iterations:
        return replace(solved, solution=replace(solved.solution, paused=None))
    tolerances = replace(tolerances, max_iterations=tolerances.max_iterations - n_spent)
    most_slow = (MOST_MOVING if roughly else MOST_SLOW) * problem.reference.region.n_nodes
    mixing = _prepare_mixing(problem)
    before = solved.solution
    found = replace(before, records=[])

    def run(model: Model, pause: Pause | None) -> Solution:
        on = replace(progress, n_before=len(before.records) + len(found.records), is_local=model is not used)
        went_on = run_gauss_newton(model, found.q, problem.solver.step, tolerances, on, Course(pause, mixing))
        return replace(went_on, records=[*found.records, *went_on.records])

    def are_few_slow(correction: Correction) -> bool:
        return correction.size.n_slow <= most_slow

    def settle() -> Solution:
        """Slow nodes alone and all nodes in turns, in the end all of them."""
        nonlocal found
        for _ in range(MOST_TIMES):
            found = run(used, are_few_slow)
            if found.paused is None or roughly:
                return found
            slow = confine_to_slow_nodes(used, found.paused, found.records[-1].cameras, systems, tolerances)
            if slow is None:
                break
            mixing.forget()
            found = run(slow, None)
            mixing.forget()
            if not found.converged:
                return found
        return run(used, None)

    try:
        found = settle()
    except ConvergenceError as error:
        error.last = _join(problem, solved, replace(error.last, records=[*found.records, *error.last.records]))
        raise
    if roughly and found.paused is not None and _is_found(found.paused.size, problem.tolerances):
        stop = found.paused.size.describe_stop(problem.tolerances)
        found = replace(found, stop=stop, converged=True, paused=None)
    return _join(problem, solved, found)


def _is_found(size: CorrectionSize, tolerances: Tolerances) -> bool:
    """Whether a correction of a rough field is small to the last digit already."""
    is_small = size.relative <= tolerances.relative or size.rms <= tolerances.rms
    return is_small and size.largest <= tolerances.largest


def _join(problem: WeightedProblem, solved: SolvedFrame, found: Solution) -> SolvedFrame:
    joined = replace(found, records=[*solved.solution.records, *found.records])
    field = average_copies(problem.team, problem.reference.subdomains, joined.q)
    notes = (*solved.notes, *problem.solver.release_notes())
    return replace(solved, field=field, solution=joined, notes=notes, is_evaluated=False)


def _prepare_mixing(problem: WeightedProblem) -> AndersonMixing:
    """Mix by what unknowns displace at nodes, each node counted once."""
    weights = []
    for subdomain in problem.reference.subdomains:
        of_unknowns = np.zeros(subdomain.n_unknowns)
        shares = np.repeat(1.0 / subdomain.node_multiplicity, subdomain.mesh.dim)
        of_unknowns[:subdomain.n_field] = subdomain.kinematics.tangent.power(2).T @ shares
        weights.append(of_unknowns)
    return AndersonMixing(problem.team, weights)


def see_solved_frame(problem: WeightedProblem, solved: SolvedFrame, as_read: ResidualModel | None = None) -> SeenFrame:
    """See the frame at a field; collective.

    Parameters
    ----------
    problem : WeightedProblem
        Of the frame.
    solved : SolvedFrame
        The field.
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
    # Fields that are roughly found judge what is blank.
    judged = None if solved.solution.paused is not None else solved.seen.excluded
    try:
        if as_read is not None and before.correction != as_read.correction and not before.blurs:
            seen = see_frame(case, as_read, q, problem.slopes, judged=judged)
            if ORDER.index(seen.whole.correction) < ORDER.index(before.correction):
                return seen
        return see_frame(case, before, q, problem.slopes, judged=judged)
    except ConvergenceError as error:
        error.last = solved
        raise
