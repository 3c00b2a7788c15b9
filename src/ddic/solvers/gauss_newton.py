"""Gauss-Newton: rank 0 decides and reports, every rank obeys the same decision.

A step q <- q + dq(q) with a constant M closes in at once wherever M is the true Jacobian, and slowly at the few nodes
where it is not. Anderson mixing: the last few corrections tell how dq changes with q along the directions that matter
there.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np

from ddic.arrays import Array
from ddic.errors import ConvergenceError, as_collective
from ddic.functionals.grey_statistics import GreyState
from ddic.parallel.field import Field, multiply_fields
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.stop_request import stop_if_asked
from ddic.parallel.team import Team
from ddic.solvers.correction_size import CorrectionSize, Tolerances
from ddic.solvers.linear_step import AllowedError, LinearStep, StepResult

DEPTH = 5
"""Differences of corrections that are kept. More of them cost memory, and mix in corrections of long ago."""

LEAST_SHARE = 1e-12
"""Share of the largest eigenvalue below which directions of the differences count as dependent."""


class AndersonMixing:
    """Mixes corrections with those before: q + dq - sum_k gamma_k (dq_k + ddq_k), |dq - sum_k gamma_k ddq_k| least.

    Parameters
    ----------
    weights : sequence of (n_unknowns,) array
        Of the squared unknowns of each owned subdomain in the norm; copies of an unknown share its weight.
    """

    def __init__(self, weights: Sequence[Array]) -> None:
        self._weights = weights
        self.forget()

    def forget(self) -> None:
        """Forget all corrections: what comes belongs to other equations."""
        self._last: tuple[Field, Field] | None = None
        # (change of q, change of dq) between successive iterations, the oldest first.
        self._changes: list[tuple[Field, Field]] = []
        self._last_norm = np.inf

    def advance(self, q: Field, dq: Field) -> Field:
        """Return the next unknowns; collective."""
        if self._last is not None:
            q_before, dq_before = self._last
            self._changes.append((q - q_before, dq - dq_before))
            del self._changes[:-DEPTH]
        self._last = q, dq
        gram = multiply_fields([*(ddq for _, ddq in self._changes), dq], self._weights)
        norm = float(np.sqrt(gram[-1, -1]))
        if norm > self._last_norm:
            # What was learnt comes from another part of the way: a plain step finds back.
            self._changes = []
        self._last_norm = norm
        n = len(self._changes)
        gamma = _solve(gram[:n, :n], gram[:n, -1])
        mixed = q + dq
        for share, (of_q, of_dq) in zip(gamma, self._changes, strict=True):
            mixed = mixed - share * (of_q + of_dq)
        return mixed


def _solve(gram: Array, right: Array) -> Array:
    """Least squares from normal equations, without directions that depend on others."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = np.linalg.pinv(gram * scale[:, None] * scale, rcond=LEAST_SHARE, hermitian=True)
    return np.asarray(scale * (scaled @ (scale * right)))


SHARE = 0.05
"""Share of the RMS of dq that a linear step may leave as its error, and of the error before its first Krylov
iteration that is tried first: Gauss-Newton with a constant gradient gains about one digit an iteration anyway. A larger
share saves Krylov iterations and may cost Gauss-Newton ones."""

GAIN = 0.2
"""RMS dq that the next iteration is expected to have, relative to the last: a guess, made good where it was wrong."""

LAST_SHARE = 0.05
"""Share of the tolerance on RMS dq that the last linear step may leave; a larger one leaves more in the result."""

PATIENCE = 20
"""Iterations after which a correction must be smaller than before. A larger value waits longer for what does not
converge."""

STAGNATION = 0.8
"""Share of the smallest RMS dq so far below which that of the last ``PATIENCE`` iterations must come: linear
convergence by 2 % an iteration passes. A larger share lets slower ones go on."""


class Model(Protocol):
    """What Gauss-Newton asks of the images."""

    @property
    def team(self) -> Team:
        """All ranks."""

    def linearize(self, q: Field) -> tuple[Field, tuple[GreyState, ...]]:
        """Pass over all pixels for b, grey levels squared per pixel, and each camera's statistics; collective."""

    def measure_correction(self, dq: Field, q: Field, tolerances: Tolerances) -> CorrectionSize:
        """Measure a correction dq, of the unknowns q before it, on displacements of nodes; collective."""


@dataclass(frozen=True)
class IterationRecord:
    """One line of the Gauss-Newton table.

    Attributes
    ----------
    number, krylov_iterations : int
        Its own, from 1, and iterations of its linear step.
    size : CorrectionSize
        Of the correction.
    cameras : tuple of GreyState
        Statistics before the correction, by camera.
    krylov_history : (krylov_iterations + 1,) array
        Residuals of its linear step, relative.
    linear_error : float
        Estimated RMS error of dq that its linear step left, pixels.
    seconds : dict
        Wall seconds so far, by phase.
    is_local : bool
        Whether it visited the pixels about slow nodes alone.
    """

    number: int
    size: CorrectionSize
    cameras: tuple[GreyState, ...]
    krylov_iterations: int
    krylov_history: Array
    linear_error: float
    seconds: dict[Phase, float]
    is_local: bool = False

    @property
    def grey(self) -> GreyState:
        """Statistics of the first camera."""
        return self.cameras[0]


Report = Callable[[IterationRecord], None]
"""Told of every iteration on every rank; only rank 0's may speak."""


@dataclass(frozen=True)
class Correction:
    """One correction of the unknowns.

    Attributes
    ----------
    q, b, dq : Field
        Unknowns before it, b there, and the correction itself.
    grey : tuple of GreyState
        Statistics of each camera before it.
    size : CorrectionSize
        How large it is.
    """

    q: Field
    b: Field
    dq: Field
    grey: tuple[GreyState, ...]
    size: CorrectionSize


Pause = Callable[[Correction], bool]
"""Asked, on all ranks, whether to pause after a correction that is not small enough yet."""


def stay_silent(record: IterationRecord) -> None:
    """Report nothing."""


@dataclass(frozen=True)
class Progress:
    """Where Gauss-Newton writes what it does.

    Attributes
    ----------
    clock : PhaseClock
        Of the phases "residual" and "linear step".
    report : callable
        Told of every iteration; by default nobody is.
    n_before : int
        Iterations of the same frame before these.
    is_local : bool
        Whether the model visits the pixels about slow nodes alone.
    """

    clock: PhaseClock
    report: Report = stay_silent
    n_before: int = 0
    is_local: bool = False


@dataclass(frozen=True)
class Solution:
    """What Gauss-Newton found.

    Attributes
    ----------
    q : Field
        Unknowns.
    records : list of IterationRecord
        How they came about.
    stop : str
        Which tolerances ended the iteration, or why it was given up.
    converged : bool
        Whether the last correction was small enough.
    paused : Correction, optional
        The last correction, where a pause was asked for after it; None otherwise.
    """

    q: Field
    records: list[IterationRecord]
    stop: str = ""
    converged: bool = True
    paused: Correction | None = None


def gauss_newton(model: Model, q: Field, step: LinearStep, tolerances: Tolerances, progress: Progress) -> Solution:
    """Iterate q <- q + dq from a start until the correction is small.

    The model gives b from the images, the step solves Eq. 11 of [BP17] for dq. Raises ConvergenceError on all ranks,
    where the correction does not become small or is not finite, and StoppedError on all ranks, where a signal asked one
    of them to stop; both with the last Solution.
    """
    solution = run_gauss_newton(model, q, step, tolerances, progress)
    if not solution.converged:
        raise as_collective(ConvergenceError(solution.stop, solution))
    return solution


def run_gauss_newton(model: Model, q: Field, step: LinearStep, tolerances: Tolerances, progress: Progress,
                     pause: Pause | None = None, mixing: AndersonMixing | None = None) -> Solution:
    """Iterate q <- q + dq until the correction is small, or does not become smaller, with steps of Eq. 11 of [BP17].

    As ``gauss_newton``, but the Solution may be converged, paused or neither. ``pause`` is asked after every correction
    whether to pause there; ``mixing`` makes the next unknowns from several corrections, else the last one alone does.
    Raises ConvergenceError on all ranks, where the correction is not finite or the linear step fails, and StoppedError
    on all ranks, where a signal asked one of them to stop; both with the last Solution.
    """
    records: list[IterationRecord] = []
    clock = progress.clock
    try:
        for number in range(progress.n_before + 1, progress.n_before + tolerances.max_iterations + 1):
            with clock.phase(Phase.RESIDUAL):
                b, grey = model.linearize(q)
            with clock.phase(Phase.LINEAR_STEP):
                last_rms = records[-1].size.rms if records else None
                solved, size = _solve_as_far_as_it_pays(model, step, q, b, tolerances, last_rms)
            records.append(IterationRecord(number, size, grey, solved.krylov_iterations, solved.krylov_history,
                                           solved.error, dict(clock.wall), progress.is_local))
            progress.report(records[-1])
            is_small = model.team.on_root(partial(_decide, size, tolerances))
            correction = Correction(q, b, solved.dq, grey, size)
            if is_small:
                return Solution(q + solved.dq, records, size.describe_stop(tolerances))
            q = q + solved.dq if mixing is None else mixing.advance(q, solved.dq)
            stop_if_asked(model.team, f"after iteration {number}, before it converged")
            if pause is not None and pause(correction):
                stop = _not_converged(records, tolerances)
                return Solution(q, records, stop, converged=False, paused=correction)
            if model.team.on_root(partial(_stagnates, records)):
                break
    except ConvergenceError as error:
        error.last = Solution(q, records)
        raise
    return Solution(q, records, _not_converged(records, tolerances), converged=False)


def _stagnates(records: Sequence[IterationRecord]) -> bool:
    """Whether the last corrections are no smaller than the ones before them."""
    if len(records) <= PATIENCE:
        return False
    sizes = [record.size.rms for record in records]
    return min(sizes[-PATIENCE:]) > STAGNATION * min(sizes[:-PATIENCE])


def _solve_as_far_as_it_pays(model: Model, step: LinearStep, q: Field, b: Field, tolerances: Tolerances,
                             last_rms: float | None) -> tuple[StepResult, CorrectionSize]:
    """Solve for dq to a share of dq that is known only afterwards: guess, then tighten."""
    if not tolerances.inexact:
        result = step.solve(q, b)
        return result, model.measure_correction(result.dq, q, tolerances)
    at_last = LAST_SHARE * tolerances.rms
    guess = AllowedError(at_last, SHARE)
    if last_rms is not None:
        guess = AllowedError(max(at_last, SHARE * GAIN * last_rms))
    result = step.solve(q, b, guess)
    size = model.measure_correction(result.dq, q, tolerances)
    while True:
        allowed = at_last if size.is_below(tolerances) else max(at_last, SHARE * size.rms)
        if not result.error > allowed:
            return result, size
        tighter = step.solve(q, b, AllowedError(allowed))
        result = _join(result, tighter)
        size = model.measure_correction(result.dq, q, tolerances)
        if tighter.krylov_iterations == 0:
            return result, size


def _join(loose: StepResult, tight: StepResult) -> StepResult:
    """The tighter of two solutions of one linear step, with the iterations of both."""
    history = np.concatenate([loose.krylov_history, tight.krylov_history[1:]])
    return StepResult(tight.dq, loose.krylov_iterations + tight.krylov_iterations, history, tight.error)


def _decide(size: CorrectionSize, tolerances: Tolerances) -> bool:
    if not size.is_finite:
        raise ConvergenceError("Gauss-Newton diverged: the correction is not finite; check the start of the "
                               "displacement and the texture, or give regularization.cut_off_wavelength")
    return size.is_below(tolerances)


def _not_converged(records: Sequence[IterationRecord], tolerances: Tolerances) -> str:
    last = records[-1]
    how = "stagnates after" if len(records) < tolerances.max_iterations else "did not converge in"
    return (f"Gauss-Newton {how} {len(records)} iterations "
            f"(last |dq|/|q| = {last.size.relative:.1e}, RMS dq = {last.size.rms:.1e} px, largest dq = "
            f"{last.size.largest:.1e} px in subdomain {last.size.subdomain}, "
            f"residual {last.grey.residual_std:.2f} grey levels); look at the images and the start, raise "
            "gauss_newton.max_iterations or loosen gauss_newton.tolerance, or give a longer "
            "regularization.cut_off_wavelength")
