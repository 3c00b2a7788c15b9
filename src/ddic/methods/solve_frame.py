"""Gauss-Newton on one frame, with operators and grey levels that fit what the frame shows of the specimen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ddic.errors import ConvergenceError, as_collective
from ddic.methods.hold_back import solve_and_hold_back
from ddic.parallel.phases import Phase, PhaseClock
from ddic.problem.held_back import exclude_and_hold
from ddic.problem.noise_of_field import accept_noise
from ddic.problem.residual_model import ResidualModel
from ddic.problem.see_frame import keep_start, see_start
from ddic.problem.solved_frame import SolvedFrame, begin_frame, see_solved_frame
from ddic.problem.views import read_frame_windows
from ddic.problem.weighted_problem import WeightedProblem
from ddic.results.listener import Listener
from ddic.solvers.gauss_newton import Progress

Array = NDArray[np.float64]

MOST_ROUNDS = 20
"""Times that a field is sought with what the last one showed before a frame is given up."""

GROWING, SETTLED = 3, 6
"""Rounds after which what was excluded stays so, and after which nothing else is, unless less and less is: cells might
come and go for ever."""


def solve_frame(problem: WeightedProblem, whole: ResidualModel, q: list[Array], listener: Listener,
                clock: PhaseClock, least_shown: float = 0.0) -> SolvedFrame:
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
    least_shown : float, optional
        Share of the cells that the start must show; any by default.

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
    cameras, case = problem.reference.inputs.cameras, problem.reference.inputs.case
    with clock.phase(Phase.RESIDUAL):
        seen, of_blur = see_start(case, cameras, whole, q, problem.slopes)
    shown = seen.measure_shown_share()
    if shown < least_shown:
        raise as_collective(ConvergenceError(f"{shown:.0%} of the elements are seen where the start puts them"))
    model, notes = problem.fit(exclude_and_hold(seen.whole.with_large_gradients(q), seen.excluded, None), q)
    notes = (*of_blur, *notes)
    _tell(listener, notes)
    start = keep_start(case, seen, q)
    listener.problem_size(problem.size)
    solved = begin_frame(seen, model, q, notes)
    for n_rounds in range(1, MOST_ROUNDS + 1):
        n_before = len(solved.solution.records)
        n_notes = len(solved.notes)
        progress = Progress(clock, listener.iteration, n_before)
        solved = solve_and_hold_back(problem, solved, start, progress)
        seen = solved.seen
        _tell(listener, solved.notes[n_notes:])
        found = solved.solution
        with clock.phase(Phase.RESIDUAL):
            now = see_solved_frame(problem, solved, start, whole if n_rounds == 1 else None)
        # For good: what pulls as at the start comes nearer, and its grey levels would push it away again.
        now = replace(now, excluded=now.excluded.hold_back(seen.excluded.held_back))
        # Cells are found again one row after the other, each from its neighbours.
        shrinks = now.excluded.count_cells(whole.team) < seen.excluded.count_cells(whole.team)
        excluded = now.excluded if n_rounds < GROWING or shrinks else seen.excluded.join(now.excluded)
        is_seen_otherwise = (n_rounds < SETTLED or shrinks) and (
            now.whole.correction != seen.whole.correction or excluded.is_other_than(whole.team, seen.excluded))
        seen = replace(now, excluded=excluded) if is_seen_otherwise else replace(
            seen, evaluation=now.evaluation, is_shown=now.is_shown)
        if not (found.converged or is_seen_otherwise):
            found = accept_noise(problem, solved.used, found, len(found.records) - n_before)
            if not found.converged:
                raise as_collective(ConvergenceError(found.stop, solved))
        # Where the start was far off, other pixels are hidden here: that held the step back, or left a node to nothing.
        followed = model if model.follows else model.with_large_gradients(found.q)
        shown_now = replace(followed, views=seen.whole.views, correction=seen.whole.correction)
        kept = exclude_and_hold(shown_now, seen.excluded, start)
        model, renewed = problem.fit(kept, found.q)
        _tell(listener, renewed)
        solved = SolvedFrame(solved.field, found, seen, model, (*solved.notes, *renewed))
        if not (is_seen_otherwise or renewed):
            listener.note(found.stop)
            return solved
    raise as_collective(ConvergenceError(
        f"what the frame shows, pixels or how far they turn, still changes after {MOST_ROUNDS} solutions; look at "
        "the masks and the start, or give a longer regularization.cut_off_wavelength", solved))


def _tell(listener: Listener, notes: Sequence[str]) -> None:
    for line in notes:
        listener.note(line)
