"""Gauss-Newton that looks, as soon as cells leave the start by much, whether mechanics hold them back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ddic.parallel.phases import Phase
from ddic.problem.held_back import ByView, SeenStart, find_displaced_cells, find_held_cells, linearize_held_cells
from ddic.problem.residual_model import ResidualModel
from ddic.problem.see_frame import measure_slopes
from ddic.problem.seen_cells import measure_seen_cells
from ddic.problem.solved_frame import SolvedFrame, solve_further
from ddic.problem.weighted_problem import WeightedProblem
from ddic.solvers.gauss_newton import Progress

Array = NDArray[np.float64]


def solve_and_hold_back(problem: WeightedProblem, solved: SolvedFrame, start: SeenStart | None,
                        progress: Progress) -> SolvedFrame:
    """Go on with Gauss-Newton, and linearize what mechanics hold back about the start; collective.

    Parameters
    ----------
    problem : WeightedProblem
        The linear step.
    solved : SolvedFrame
        Where to go on from.
    start : SeenStart or None
        Of the frame; None where mechanics hold nothing back.
    progress : Progress
        Where to write.

    Returns
    -------
    SolvedFrame
        Converged or not, with all iterations; cells that are held back are marked in what is excluded.

    Raises
    ------
    ConvergenceError
        On all ranks, where an iteration fails; with the last SolvedFrame.
    """
    if start is None:
        return solve_further(problem, solved, progress)
    judged, now = find_displaced_cells(start, solved.solution.q), solved

    def revise(q: Sequence[Array]) -> ResidualModel | None:
        nonlocal judged, now
        displaced = find_displaced_cells(start, q)
        if problem.team.sum(_count_new(displaced, judged)) == 0:
            return None
        judged = _join(judged, displaced)
        with progress.clock.phase(Phase.RESIDUAL):
            now = _hold_back(problem, now, start, q)
        return now.used

    found = solve_further(problem, solved, progress, revise)
    return replace(found, seen=now.seen, used=now.used)


def _hold_back(problem: WeightedProblem, solved: SolvedFrame, start: SeenStart, q: Sequence[Array]) -> SolvedFrame:
    """The frame with the cells linearized that are held back at q; M stays."""
    seen = solved.seen
    evaluation = seen.whole.evaluate(q)
    cells = measure_seen_cells(seen.whole, evaluation, measure_slopes(seen.whole, problem.slopes))
    excluded = seen.excluded.hold_back(find_held_cells(start, q, cells))
    return replace(solved, seen=replace(seen, excluded=excluded),
                   used=linearize_held_cells(solved.used, excluded, start))


def _count_new(displaced: ByView, judged: ByView) -> int:
    return sum(int((now & ~before).sum()) for of_views in zip(displaced, judged, strict=True)
               for now, before in zip(*of_views, strict=True))


def _join(one: ByView, other: ByView) -> ByView:
    return [tuple(a | b for a, b in zip(*of_views, strict=True)) for of_views in zip(one, other, strict=True)]
