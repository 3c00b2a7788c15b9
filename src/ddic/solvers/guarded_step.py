"""A linear step that another one takes the place of, once it does not converge."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ddic.errors import ConvergenceError, is_collective
from ddic.solvers.linear_step import AllowedError, LinearStep, StepResult


class GuardedStep:
    """Solves by an iterative step as long as that converges, then by another one.

    Parameters
    ----------
    first : LinearStep
        The iterative step, from now on this one's to destroy.
    build_other : callable
        Builds what takes its place; collective, called once at most, after the first is destroyed.
    """

    def __init__(self, first: LinearStep, build_other: Callable[[ConvergenceError], LinearStep]) -> None:
        self._step: LinearStep | None = first
        self._build_other: Callable[[ConvergenceError], LinearStep] | None = build_other

    def solve(self, q: Sequence[NDArray[np.float64]], b: Sequence[NDArray[np.float64]],
              allowed: AllowedError | None = None) -> StepResult:
        """Solve for dq_s; collective.

        Parameters
        ----------
        q : sequence of (n_unknowns,) arrays
            q_s of each owned subdomain, pixels.
        b : sequence of (n_unknowns,) arrays
            Its b_s, grey levels squared per pixel.
        allowed : AllowedError, optional
            Error that may be left; None: what the tolerance allows.

        Returns
        -------
        StepResult
            Of the first step, or of the other one.

        Raises
        ------
        ConvergenceError, SingularSubdomainError, FactorizationError
            On all ranks, of the step that took the first one's place.
        RuntimeError
            Where the step was freed.
        """
        if self._step is None:
            raise RuntimeError("the linear step was freed")
        try:
            return self._step.solve(q, b, allowed)
        except ConvergenceError as error:
            if self._build_other is None or not is_collective(error):
                raise
            build, self._build_other = self._build_other, None
            # Before the other one needs its memory.
            self.destroy()
            self._step = build(error)
        return self._step.solve(q, b, allowed)

    def forget(self) -> None:
        """Have the step at hand forget what it learnt."""
        if self._step is not None:
            self._step.forget()

    def destroy(self) -> None:
        """Free what the step at hand holds."""
        if self._step is not None:
            self._step.destroy()
        self._step = None
