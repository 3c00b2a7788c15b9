"""The field of a frame and what it was found from."""

from __future__ import annotations

from dataclasses import dataclass

from ddic.problem.exclusions import Exclusions
from ddic.problem.residual_model import Evaluation, ResidualModel
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
    whole, used : ResidualModel
        Of all pixels that the frame shows, and of those that were used.
    evaluation : Evaluation
        Of all of them, at the field.
    excluded : Exclusions
        The others, and cells.
    notes : tuple of str
        What was renewed.
    """

    field: ContinuousField
    solution: Solution
    whole: ResidualModel
    used: ResidualModel
    evaluation: Evaluation
    excluded: Exclusions
    notes: tuple[str, ...]
