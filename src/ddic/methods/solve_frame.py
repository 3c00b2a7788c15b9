"""Gauss-Newton on one frame, with operators and grey levels that fit what the frame shows of the specimen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ddic.errors import ConvergenceError, as_collective
from ddic.parallel.phases import Phase, PhaseClock
from ddic.problem.exclusions import exclude
from ddic.problem.noise_of_field import accept_noise
from ddic.problem.residual_model import ResidualModel
from ddic.problem.see_frame import see_frame, see_start
from ddic.problem.solved_frame import SolvedFrame
from ddic.problem.views import read_frame_windows
from ddic.problem.weighted_problem import WeightedProblem
from ddic.results.listener import Listener
from ddic.solvers.dual.continuity import average_copies
from ddic.solvers.gauss_newton import Progress, Solution, run_gauss_newton

Array = NDArray[np.float64]

MOST_ROUNDS = 8
"""Times that a field is sought with what the last one showed before a frame is given up."""

GROWING = 3
"""Rounds after which what was left out stays so: cells might come and go for ever."""


def solve_frame(problem: WeightedProblem, whole: ResidualModel, q: list[Array], listener: Listener,
                clock: PhaseClock) -> SolvedFrame:
    """Iterate from a start until neither the field nor what the frame shows of it changes; collective.

    Parameters
    ----------
    problem : WeightedProblem
        Operators, renewed where the frame asks for it.
    whole : ResidualModel
        Of all pixels that the frame shows, cameras weighted.
    q : list of (n_unknowns,) array
        Start of each owned subdomain.
    listener : Listener
        Told what happens.
    clock : PhaseClock
        Of the phases.

    Returns
    -------
    SolvedFrame
        Where nothing changes any more.

    Raises
    ------
    ConvergenceError, SingularSubdomainError, FactorizationError
        On all ranks; the first with the last SolvedFrame.
    """
    with clock.phase(Phase.READ):
        whole.team.together(lambda: read_frame_windows(whole.views, q))
    case, textures, subdomains = problem.reference.inputs.case, problem.textures, problem.reference.subdomains
    with clock.phase(Phase.RESIDUAL):
        seen, of_blur = see_start(case, problem.reference.inputs.cameras, whole, q, textures)
    model, notes = _fit_operators(problem, exclude(seen.whole.with_large_gradients(q), seen.excluded), q)
    notes = (*of_blur, *notes)
    _tell(listener, notes)
    listener.problem_size(problem.size)
    solved = SolvedFrame(average_copies(whole.team, subdomains, q), Solution(q, []), seen, model, notes)
    for n_rounds in range(1, MOST_ROUNDS + 1):
        found = _iterate(problem, solved, Progress(clock, listener.iteration, len(solved.solution.records)))
        field = average_copies(whole.team, subdomains, found.q)
        last = replace(solved, field=field, solution=found, is_evaluated=False)
        with clock.phase(Phase.RESIDUAL), _last_field_given(last):
            now = see_frame(case, seen.whole, field.q, textures)
        excluded = now.excluded if n_rounds < GROWING else seen.excluded.join(now.excluded)
        is_seen_otherwise = (now.whole.correction != seen.whole.correction
                             or excluded.is_other_than(whole.team, seen.excluded))
        seen = replace(now, excluded=excluded) if is_seen_otherwise else replace(seen, evaluation=now.evaluation)
        if not (found.converged or is_seen_otherwise):
            found = accept_noise(problem, solved.used, found)
            if not found.converged:
                raise as_collective(ConvergenceError(found.stop, replace(solved, field=field, solution=found)))
        # Where the start was far off, other pixels are hidden here: that held the step back, or left a node to nothing.
        followed = model if model.follows else model.with_large_gradients(found.q)
        kept = exclude(replace(followed, views=seen.whole.views, correction=seen.whole.correction), seen.excluded)
        model, renewed = _fit_operators(problem, kept, found.q)
        _tell(listener, renewed)
        solved = SolvedFrame(field, found, seen, model, (*solved.notes, *renewed))
        if not (is_seen_otherwise or renewed):
            listener.note(found.stop)
            return solved
    raise as_collective(ConvergenceError(
        f"what the frame shows, pixels or how far they turn, still changes after {MOST_ROUNDS} solutions; look at "
        "the masks and the start, or give a longer regularization.cut_off_wavelength", solved))


@contextmanager
def _last_field_given(last: SolvedFrame) -> Iterator[None]:
    """Within it, an error of a field that shows nothing of the specimen has that field."""
    try:
        yield
    except ConvergenceError as error:
        error.last = last
        raise


def _iterate(problem: WeightedProblem, solved: SolvedFrame, progress: Progress) -> Solution:
    """Go on from what was solved; where that fails, the error has the last field."""
    before = solved.solution
    try:
        found = run_gauss_newton(solved.used, before.q, problem.solver.step, problem.tolerances, progress)
    except ConvergenceError as error:
        last = replace(error.last, records=[*before.records, *error.last.records])
        field = average_copies(problem.team, problem.reference.subdomains, last.q)
        error.last = replace(solved, solution=last, field=field, is_evaluated=False)
        raise
    return replace(found, records=[*before.records, *found.records])


def _fit_operators(problem: WeightedProblem, model: ResidualModel,
                   q: Sequence[Array]) -> tuple[ResidualModel, tuple[str, ...]]:
    """Let rotations cost nothing and M count what is used; collective."""
    turned, of_rotation = problem.hold_rotation(model, q)
    fitted, of_pixels = problem.renew(turned, q)
    return fitted, (*of_rotation, *of_pixels)


def _tell(listener: Listener, notes: Sequence[str]) -> None:
    for line in notes:
        listener.note(line)
