"""What Gauss-Newton asks of a linear step.

A linear step that another one takes the place of, once it does not converge.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from ddic.arrays import Array
from ddic.errors import ConvergenceError, is_collective
from ddic.parallel.field import Field


@dataclass(frozen=True)
class AllowedError:
    """How large an RMS error of dq an iterative linear step may leave: the larger of two.

    Attributes
    ----------
    rms : float
        This much, pixels.
    share : float
        This share of the error before the first iteration.
    """

    rms: float
    share: float = 0.0


@dataclass(frozen=True)
class StepResult:
    """Solution of one linear step.

    Attributes
    ----------
    dq : Field
        Correction, pixels.
    krylov_iterations : int
        Iterations of the Krylov solver; 0 if direct.
    krylov_history : (n,) array
        Its residuals relative to its right-hand side; empty if direct.
    error : float
        Estimated RMS error of dq that the linear solver left, pixels; 0 if direct, nan if it cannot tell.
    """

    dq: Field
    krylov_iterations: int = 0
    krylov_history: Array = field(default_factory=lambda: np.zeros(0))
    error: float = 0.0


class LinearStep(Protocol):
    """Solves (M + eta Kbar^T Kbar) dq = b - eta Kbar^T Kbar q, Eq. 11 of [BP17], in its own way."""

    def solve(self, q: Field, b: Field, allowed: AllowedError | None = None) -> StepResult:
        """Solve for the correction dq; collective.

        Parameters
        ----------
        q : Field
            Unknowns, pixels; the copies of one may differ.
        b : Field
            Forces on them, grey levels squared per pixel; the copies of an unknown have a share each.
        allowed : AllowedError, optional
            Error that may be left, never less than the step's own tolerance allows; None: that tolerance.

        Returns
        -------
        StepResult
            With dq by which q + dq is one field: without jumps.

        Raises
        ------
        ConvergenceError
            On all ranks, where an iterative solver does not converge.
        """

    def forget(self) -> None:
        """Forget what earlier steps taught, so that the next one depends on its q and b alone."""

    def destroy(self) -> None:
        """Free what PETSc holds."""


class GuardedStep(LinearStep):
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

    def solve(self, q: Field, b: Field, allowed: AllowedError | None = None) -> StepResult:
        """Solve for dq by the first step, or by the one in its place, whose errors it raises on all ranks; collective.

        Raises
        ------
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
