"""Which linear step was chosen for a case that leaves it open, and why."""

from __future__ import annotations

from dataclasses import dataclass

from ddic.case.schema import Case


@dataclass(frozen=True)
class SolverChoice:
    """What ``solver.method = "auto"`` came to.

    Attributes
    ----------
    asked : Case
        As it was given.
    case : Case
        With method, number of subdomains and preconditioner.
    note : str
        What was chosen and why, a line for the log.
    most_iterations : int or None
        Conjugate gradients' iterations after which a step is factorised instead; None where it cannot be, or need not.
    """

    asked: Case
    case: Case
    note: str
    most_iterations: int | None
