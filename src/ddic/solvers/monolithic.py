"""The linear step on the whole mesh by one sparse Cholesky: the oracle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ddic.solvers.linear_step import Leave, StepResult
from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.local_system import LocalSystem


class MonolithicStep:
    """Solves Eq. 11 of [BP17] directly; also one subdomain's independent step, where it is alone."""

    def __init__(self, system: LocalSystem, operator: LocalOperator) -> None:
        self._system = system
        self._operator = operator

    def solve(self, q: Sequence[NDArray[np.float64]], b: Sequence[NDArray[np.float64]],
              leave: Leave | None = None) -> StepResult:
        """Solve for the only subdomain's dq."""
        dq = self._operator.solve(self._system.right_hand_side(b[0], q[0]))
        return StepResult([dq], 0, np.zeros(0), 0.0)

    def destroy(self) -> None:
        """Nothing to free: the factor belongs to whoever made it."""
