"""Gauss-Newton: rank 0 decides and reports, every rank obeys the same decision.

Anderson mixing: Gauss-Newton's next unknowns from its last few corrections.

A step q <- q + dq(q) with a constant M closes in at once wherever M is the true Jacobian, and slowly at the few nodes
where it is not. The last corrections tell how dq changes with q along the directions that matter there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ddic.errors import ConvergenceError, as_collective
from ddic.functionals.grey_statistics import GreyState
from ddic.parallel.phases import Phase, PhaseClock
from ddic.parallel.stop_request import stop_if_asked
from ddic.parallel.team import Team
from ddic.solvers.correction_size import CorrectionSize, Tolerances
from ddic.solvers.linear_step import AllowedError, LinearStep, StepResult

Array = NDArray[np.float64]

DEPTH = 5
"""Differences of corrections that are kept. More of them cost memory, and mix in corrections of long ago."""

LEAST_SHARE = 1e-12
"""Share of the largest eigenvalue below which directions of the differences count as dependent."""


class AndersonMixing:
    """Mixes corrections with those before: q + dq - sum_k gamma_k (dq_k + ddq_k), |dq - sum_k gamma_k ddq_k| least.

    Parameters
    ----------
    team : Team
        All ranks.
    weights : sequence of (n_unknowns,) array
        Of the squared unknowns of each owned subdomain in the norm; copies of an unknown share its weight.
    """

    def __init__(self, team: Team, weights: Sequence[Array]) -> None:
        self._team, self._weights = team, weights
        self._last: tuple[list[Array], list[Array]] | None = None
        # (change of q, change of dq) between successive iterations, the oldest first.
        self._changes: list[tuple[list[Array], list[Array]]] = []
        self._last_norm = np.inf

    def forget(self) -> None:
        """Forget all corrections: what comes belongs to other equations."""
        self._last, self._changes, self._last_norm = None, [], np.inf

    def advance(self, q: Sequence[Array], dq: Sequence[Array]) -> list[Array]:
        """Return the next unknowns; collective."""
        if self._last is not None:
            before, dq_before = self._last
            self._changes.append(([a - b for a, b in zip(q, before, strict=True)],
                                  [a - b for a, b in zip(dq, dq_before, strict=True)]))
            del self._changes[:-DEPTH]
        self._last = [np.array(q_s) for q_s in q], [np.array(dq_s) for dq_s in dq]
        products = self._team.ordered_sum([self._multiply(place, dq_s).ravel() for place, dq_s in enumerate(dq)])
        gram = products.reshape(len(self._changes) + 1, -1)
        norm = float(np.sqrt(gram[-1, -1]))
        if norm > self._last_norm:
            # What was learnt comes from another part of the way: a plain step finds back.
            self._changes = []
        self._last_norm = norm
        gamma = np.zeros(0) if not self._changes else _solve(gram[:-1, :-1], gram[:-1, -1])
        mixed = [q_s + dq_s for q_s, dq_s in zip(q, dq, strict=True)]
        for share, (of_q, of_dq) in zip(gamma, self._changes, strict=True):
            mixed = [mixed_s - share * (a + b) for mixed_s, a, b in zip(mixed, of_q, of_dq, strict=True)]
        return mixed

    def _multiply(self, place: int, dq: Array) -> Array:
        """Products of a subdomain's changes of dq, and of dq itself, with each other, (n + 1, n + 1)."""
        vectors = np.array([*(of_dq[place] for _, of_dq in self._changes), dq])
        return np.asarray((vectors * self._weights[place]) @ vectors.T)


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
        ...

    def linearize(self, q: Sequence[Array]) -> tuple[list[Array], tuple[GreyState, ...]]:
        """Pass over all pixels; collective.

        From the unknowns of each owned subdomain come its b_s, (n_unknowns,), grey levels squared per pixel, and the
        grey statistics of each camera.
        """
        ...

    def measure_correction(self, dq: Sequence[Array], q: Sequence[Array], tolerances: Tolerances) -> CorrectionSize:
        """Measure a correction dq, of the unknowns q before it, on displacements of nodes; collective."""
        ...


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
    q, b, dq : list of (n_unknowns,) array
        Unknowns before it, b there, and the correction itself, of each owned subdomain.
    grey : tuple of GreyState
        Statistics of each camera before it.
    size : CorrectionSize
        How large it is.
    """

    q: list[Array]
    b: list[Array]
    dq: list[Array]
    grey: tuple[GreyState, ...]
    size: CorrectionSize


Pause = Callable[[Correction], bool]
"""Asked, on all ranks, whether to pause after a correction that is not small enough yet."""


@dataclass(frozen=True)
class Course:
    """How iterations go on.

    Attributes
    ----------
    pause : callable, optional
        Asked after every correction whether to pause there; never, by default.
    mixing : AndersonMixing, optional
        Makes the next unknowns from several corrections; by default the last one alone does.
    """

    pause: Pause | None = None
    mixing: AndersonMixing | None = None


STRAIGHT_ON = Course()


@dataclass(frozen=True)
class Progress:
    """Where Gauss-Newton writes what it does.

    Attributes
    ----------
    clock : PhaseClock
        Of the phases "residual" and "linear step".
    report : callable
        Told of every iteration.
    n_before : int
        Iterations of the same frame before these.
    is_local : bool
        Whether the model visits the pixels about slow nodes alone.
    """

    clock: PhaseClock
    report: Report
    n_before: int = 0
    is_local: bool = False


def stay_silent(record: IterationRecord) -> None:
    """Report nothing."""


@dataclass(frozen=True)
class Solution:
    """What Gauss-Newton found.

    Attributes
    ----------
    q : list of (n_unknowns,) array
        Unknowns of each owned subdomain.
    records : list of IterationRecord
        How they came about.
    stop : str
        Which tolerances ended the iteration, or why it was given up.
    converged : bool
        Whether the last correction was small enough.
    paused : Correction, optional
        The last correction, where a pause was asked for after it; None otherwise.
    """

    q: list[Array]
    records: list[IterationRecord]
    stop: str = ""
    converged: bool = True
    paused: Correction | None = None


def gauss_newton(model: Model, q: Sequence[Array], step: LinearStep, tolerances: Tolerances,
                 progress: Progress) -> Solution:
    """Iterate q <- q + dq until the correction is small.

    The model gives b from the images, the step solves Eq. 11 of [BP17] for dq, and ``q`` is the start of each owned
    subdomain. Raises ConvergenceError on all ranks, where the correction does not become small or is not finite, and
    StoppedError on all ranks, where a signal asked one of them to stop; both with the last Solution.
    """
    solution = run_gauss_newton(model, q, step, tolerances, progress)
    if not solution.converged:
        raise as_collective(ConvergenceError(solution.stop, solution))
    return solution


def run_gauss_newton(model: Model, q: Sequence[Array], step: LinearStep, tolerances: Tolerances, progress: Progress,
                     course: Course = STRAIGHT_ON) -> Solution:
    """Iterate q <- q + dq until the correction is small, or does not become smaller, with steps of Eq. 11 of [BP17].

    As ``gauss_newton``, but the Solution may be converged, paused or neither; ``course`` says how to go on. Raises
    ConvergenceError on all ranks, where the correction is not finite or the linear step fails, and StoppedError on all
    ranks, where a signal asked one of them to stop; both with the last Solution.
    """
    found = Solution([np.array(q_s) for q_s in q], [])
    try:
        return _iterate(model, found, step, tolerances, progress, course)
    except ConvergenceError as error:
        error.last = found
        raise


def _iterate(model: Model, found: Solution, step: LinearStep, tolerances: Tolerances, progress: Progress,
             course: Course) -> Solution:
    """Iterate from what was found, which holds the last finite unknowns and all iterations at any time."""
    current, records = found.q, found.records
    clock = progress.clock
    for number in range(1, tolerances.max_iterations + 1):
        with clock.phase(Phase.RESIDUAL):
            b, grey = model.linearize(current)
        with clock.phase(Phase.LINEAR_STEP):
            last_rms = records[-1].size.rms if records else None
            result, size = _solve_as_far_as_it_pays(model, step, (current, b), tolerances, last_rms)
        records.append(IterationRecord(progress.n_before + number, size, grey, result.krylov_iterations,
                                       result.krylov_history, result.error, dict(clock.wall),
                                       progress.is_local))
        progress.report(records[-1])
        is_small = model.team.on_root(partial(_decide, size, tolerances))
        correction = Correction(list(current), b, result.dq, grey, size)
        if course.mixing is None or is_small:
            current[:] = [q_s + dq for q_s, dq in zip(current, result.dq, strict=True)]
        else:
            current[:] = course.mixing.advance(current, result.dq)
        if is_small:
            return Solution(current, records, size.describe_stop(tolerances))
        stop_if_asked(model.team, f"after iteration {records[-1].number}, before it converged")
        if course.pause is not None and course.pause(correction):
            return Solution(current, records, _not_converged(records, tolerances), converged=False, paused=correction)
        if model.team.on_root(partial(_stagnates, records)):
            break
    return Solution(current, records, _not_converged(records, tolerances), converged=False)


def _stagnates(records: Sequence[IterationRecord]) -> bool:
    """Whether the last corrections are no smaller than the ones before them."""
    if len(records) <= PATIENCE:
        return False
    sizes = [record.size.rms for record in records]
    return min(sizes[-PATIENCE:]) > STAGNATION * min(sizes[:-PATIENCE])


def _solve_as_far_as_it_pays(model: Model, step: LinearStep, system: tuple[Sequence[Array], Sequence[Array]],
                             tolerances: Tolerances, last_rms: float | None) -> tuple[StepResult, CorrectionSize]:
    """Solve for dq, system = (q, b), to a share of dq that is known only afterwards: guess, then tighten."""
    q, b = system
    at_last = LAST_SHARE * tolerances.rms
    if not tolerances.inexact:
        result = step.solve(q, b, None)
        return result, model.measure_correction(result.dq, q, tolerances)
    if last_rms is None:
        guess = AllowedError(at_last, SHARE)
    else:
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
