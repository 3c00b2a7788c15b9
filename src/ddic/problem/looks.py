"""Which look at a frame is believed, and whether it tells something else than the last.

Cells and pixels come and go with the field that they are judged by: they must come to rest.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ddic.problem.see_frame import SeenFrame

MOST_ROUGH = 3
"""Looks at fields that are roughly found, if each shows something else; from the last of them on, what was excluded
stays so, unless clearly less is."""

SETTLED, SHRINKING = 5, 0.9
"""Looks after which nothing else is excluded, and share of the fewest pixels so far below which fewer are nevertheless:
pixels might come and go for ever."""


class Looks:
    """Looks at a frame after the start's, and what of each is believed.

    Parameters
    ----------
    is_regularized : bool
        Whether mechanics hold nodes beside what is hidden.

    Attributes
    ----------
    number : int
        Of the last look.
    is_rough : bool
        Whether the next one is at a field that is roughly found.
    """

    def __init__(self, *, is_regularized: bool) -> None:
        self.number, self.is_rough, self._is_regularized = 0, True, is_regularized
        self._was_found, self._fewest = False, np.inf

    def choose(self, seen: SeenFrame, now: SeenFrame, *, is_paused: bool) -> tuple[SeenFrame, bool]:
        """Choose what to go on with, and tell whether it is other than before; collective."""
        team = now.whole.team
        self.number += 1
        if is_paused and not self._is_regularized:
            # Nothing holds nodes beside what is hidden, and a rough field would be judged by what drags them there. It
            # tells the noise, though, and what only the start put elsewhere.
            self.is_rough = False
            return replace(now, excluded=seen.excluded.intersect(now.excluded)), True
        # Cells are found again one row after the other, each from its neighbours.
        n_excluded = now.excluded.count_pixels(now.whole)
        shrinks = n_excluded < SHRINKING * self._fewest
        self._fewest = min(self._fewest, n_excluded)
        excluded = now.excluded.keep_pulled(seen.excluded)
        if (self._was_found or self.number >= MOST_ROUGH) and not shrinks:
            excluded = seen.excluded.join(excluded)
        is_other = (self.number < SETTLED or shrinks) and (
            now.whole.correction != seen.whole.correction or excluded.is_other_than(team, seen.excluded))
        self._was_found |= not is_paused
        self.is_rough = is_other and not self._was_found and self.number < MOST_ROUGH
        if is_other:
            return replace(now, excluded=excluded), True
        return replace(now, whole=seen.whole, excluded=seen.excluded.with_marks(now.excluded)), False
