"""What Gauss-Newton asks of a linear step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class StepResult:
    """Solution of one linear step.

    dq: correction of each owned subdomain, (n_dofs,), pixels; krylov_iterations: interface iterations;
    krylov_history: residuals of the interface problem relative to its right-hand side (empty if direct).
    """

    dq: list[NDArray[np.float64]]
    krylov_iterations: int
    krylov_history: NDArray[np.float64]


class Step(Protocol):
    """Solves (M + eta Kbar^T Kbar) dq = b - eta Kbar^T Kbar q, Eq. 11 of [BP17], in its own way."""

    def solve(self, q: Sequence[NDArray[np.float64]], b: Sequence[NDArray[np.float64]]) -> StepResult:
        """Correction dq_s of this rank's subdomains from their q_s and b_s; collective."""
        ...

    def destroy(self) -> None:
        """Free what PETSc holds."""
        ...
