"""The field of a frame and what it was found from."""

from __future__ import annotations

from dataclasses import dataclass

from ddic.problem.residual_model import ResidualModel
from ddic.problem.see_frame import SeenFrame
from ddic.solvers.dual.continuity import ContinuousField
from ddic.solvers.gauss_newton import Solution


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
        What was renewed.
    is_evaluated : bool
        Whether what is seen was evaluated at the field.
    """

    field: ContinuousField
    solution: Solution
    seen: SeenFrame
    used: ResidualModel
    notes: tuple[str, ...]
    is_evaluated: bool = True
