"""What of a frame does not show the specimen, found from the residual.

A cell stands out where its residual is that of a displacement error beyond a limit, more than noise explains. If some
of its pixels are spoilt, these are excluded, and the whole cell where they are many. If none is by itself, the cell is
excluded for now: where its neighbours put it, it may be seen again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ddic.errors import ConvergenceError, as_collective
from ddic.parallel.team import Team
from ddic.problem.exclusions import BLANK, SPOILT, UNSEEN, Exclusions
from ddic.problem.residual_limits import AT_START, NO_LIMITS, Limits
from ddic.problem.residual_model import ResidualModel
from ddic.problem.seen_cells import SeenCells, TypicalCell
from ddic.problem.standing_out import find_standing_out
from ddic.problem.view_exclusions import Rules, SeenView, find_view_exclusions
from ddic.problem.weak_cells import exclude_weak_cells

Array = NDArray[np.float64]

LARGEST_SHARE = 0.5
"""Share of the pixels that are shown which may be spoilt; of a larger one nobody knows which part is right."""

START_SHARE = 0.3
"""The same at a start, which may be wrong itself: with more, nothing is excluded before the first iterations."""


def find_exclusions(whole: ResidualModel, q: Sequence[Array], seen: Sequence[Sequence[SeenCells]],
                    typical: Mapping[int, TypicalCell], rules: Rules, judged: Exclusions | None) -> Exclusions:
    """Find what of a frame does not show the specimen; collective.

    Parameters
    ----------
    whole : ResidualModel
        With all pixels that the frame shows.
    q : sequence of (n_unknowns,) array
        Unknowns of each owned subdomain.
    seen : sequence of sequence of SeenCells
        Cells of each subdomain and view.
    typical : mapping of int to TypicalCell
        By camera.
    rules : Rules
        By which they are judged.
    judged : Exclusions or None
        By an earlier look, from which is taken which cells are blank; None where this one judges.

    Returns
    -------
    Exclusions
        Of owned subdomains.

    Raises
    ------
    ConvergenceError
        On all ranks, where most of the frame shows something else.
    """
    states_before = [(None,) * len(of_views) for of_views in seen] if judged is None else judged.cells
    views = [[SeenView(view, q_s, cells, typical[view.camera], states)
              for view, cells, states in zip(of_subdomain.views, *of_views, strict=True)]
             for of_subdomain, q_s, *of_views in zip(whole.views, q, seen, states_before, strict=True)]
    chosen = replace(rules, limits=_choose_limits(whole.team, views, rules.limits))
    excluded = whole.team.together(lambda: _find_in_views(views, chosen))
    # Mechanics hold what a frame does not show; what it shows beside something else is another matter.
    doubted = (BLANK, SPOILT) if rules.is_regularized else (BLANK, SPOILT, UNSEEN)
    n_doubted = sum(int(np.isin(state, doubted).any()) for of_subdomain in excluded.cells for state in of_subdomain)
    return exclude_weak_cells(whole, excluded) if whole.team.sum(n_doubted) else excluded


def _choose_limits(team: Team, views: Sequence[Sequence[SeenView]], limits: Limits) -> Limits:
    """Choose no limits where too much stands out at a start; raise where too much does later."""
    counts = np.zeros(2)
    for of_subdomain in views:
        for seen in of_subdomain:
            stands_out = find_standing_out(seen.cells, seen.typical, limits.cell)
            counts += seen.cells.n_pixels.sum(), seen.cells.n_pixels[stands_out].sum()
    n_pixels, n_standing_out = team.sum(counts)
    if limits is AT_START and n_standing_out > START_SHARE * n_pixels:
        return NO_LIMITS
    if n_standing_out > LARGEST_SHARE * n_pixels:
        raise as_collective(ConvergenceError(
            f"{n_standing_out / n_pixels:.0%} of the pixels do not show in the deformed image what the field says: the "
            "start is wrong, or the images do not show the same surface; look at both, and give a start"))
    return limits


def _find_in_views(views: Sequence[Sequence[SeenView]], rules: Rules) -> Exclusions:
    """What the views of owned subdomains do not show."""
    cells, pixels, pulled = [], [], []
    for of_subdomain in views:
        found = [find_view_exclusions(seen, rules) for seen in of_subdomain]
        cells.append(tuple(states for states, _, _ in found))
        pixels.append(tuple(spots for _, spots, _ in found))
        pulled.append(tuple(held for _, _, held in found))
    return Exclusions(cells, pixels, pulled)
