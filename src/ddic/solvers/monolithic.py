"""The linear step on the whole mesh by one sparse Cholesky: the oracle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ddic.solvers.linear_step import AllowedError, StepResult
from ddic.solvers.local_operator import LocalOperator
from ddic.solvers.local_system import LocalSystem


class MonolithicStep:
    """Solves Eq. 11 of [BP17] directly; also one subdomain's independent step, where it is alone.

    Parameters
    ----------
    system : LocalSystem
        Of the only subdomain.
    operator : LocalOperator
        The factor of its A_s, which stays its maker's to destroy.

    Attributes
    ----------
    operator : LocalOperator
        The factor.
    """

    def __init__(self, system: LocalSystem, operator: LocalOperator) -> None:
        self._system = system
        self.operator = operator

    def solve(self, q: Sequence[NDArray[np.float64]], b: Sequence[NDArray[np.float64]],
              allowed: AllowedError | None = None) -> StepResult:
        """Solve for the only subdomain's dq.

        Parameters
        ----------
        q : sequence of one (n_unknowns,) array
            Unknowns, pixels.
        b : sequence of one (n_unknowns,) array
            Grey levels squared per pixel.
        allowed : AllowedError, optional
            Does not matter: the step is direct.

        Returns
        -------
        StepResult
            Without an error.
        """
        dq = self.operator.solve(self._system.right_hand_side(b[0], q[0]))
        return StepResult([dq], 0, np.zeros(0), 0.0)

    def forget(self) -> None:
        """Do nothing: no step teaches another."""

    def destroy(self) -> None:
        """Nothing to free: the factor belongs to whoever made it."""
