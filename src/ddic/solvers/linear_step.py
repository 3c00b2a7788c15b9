"""What Gauss-Newton asks of a linear step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Leave:
    """How large an RMS error of dq an iterative linear step may leave, pixels.

    error: this much, or, where larger, ``share`` of the error before the first iteration.
    """

    error: float
    share: float = 0.0


@dataclass(frozen=True)
class StepResult:
    """Solution of one linear step.

    dq: correction of each owned subdomain, (n_dofs,), pixels; krylov_iterations: interface iterations;
    krylov_history: residuals of the interface problem relative to its right-hand side (empty if direct);
    error: estimated RMS error of dq that the linear solver left, pixels (0 if direct, nan if it cannot tell).
    """

    dq: list[NDArray[np.float64]]
    krylov_iterations: int
    krylov_history: NDArray[np.float64]
    error: float


class Step(Protocol):
    """Solves (M + eta Kbar^T Kbar) dq = b - eta Kbar^T Kbar q, Eq. 11 of [BP17], in its own way."""

    def solve(self, q: Sequence[NDArray[np.float64]], b: Sequence[NDArray[np.float64]],
              leave: Leave | None = None) -> StepResult:
        """Correction dq_s of this rank's subdomains from their q_s and b_s; collective.

        leave: error allowed, never less than the step's own tolerance allows; None: that tolerance.
        """
        ...

    def destroy(self) -> None:
        """Free what PETSc holds."""
        ...
