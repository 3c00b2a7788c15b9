"""Gauss-Newton: rank 0 decides and reports, every rank obeys the same decision."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ddic.errors import ConvergenceError, on_all_ranks
from ddic.functionals.correlation import Residual
from ddic.functionals.grey_levels import GreyCorrection, GreyState, GreySums
from ddic.functionals.view import View
from ddic.parallel.phases import PhaseClock
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.solvers.linear_step import Leave, Step, StepResult

SHARE = 0.05
"""Share of the RMS of dq that a linear step may leave as its error, and of the error before its first Krylov
iteration that is tried first: Gauss-Newton with a constant gradient gains about one digit an iteration anyway."""

GAIN = 0.2
"""RMS dq that the next iteration is expected to have, relative to the last: a guess, made good where it was wrong."""

LAST_SHARE = 0.05
"""Share of the tolerance on RMS dq that the last linear step may leave."""


@dataclass(frozen=True)
class Tolerances:
    """Stops at |dq|/|q| <= relative or RMS dq <= rms pixels, whichever comes first.

    inexact: linear steps are solved only as far as Gauss-Newton's progress asks, the last one to rms / 20.
    """

    relative: float = 1e-3
    rms: float = 1e-4
    max_iterations: int = 50
    inexact: bool = True


@dataclass(frozen=True)
class OwnedPart:
    """An owned subdomain with its pixels; views: of its own camera first, then of others that see it as well."""

    subdomain: Subdomain
    views: tuple[View, ...]

    @property
    def view(self) -> View:
        """What its own camera says."""
        return self.views[0]

    @property
    def n_dofs(self) -> int:
        """Number of nodal displacements, which come before the other unknowns."""
        return self.subdomain.n_dofs


@dataclass(frozen=True)
class IterationRecord:
    """One line of the Gauss-Newton table.

    number: from 1; relative: |dq|/|q|; rms: RMS dq, pixels; cameras: statistics before the correction, by camera;
    krylov_iterations, krylov_history, linear_error: of its linear step (``StepResult``); seconds: wall seconds so
    far by phase.
    """

    number: int
    relative: float
    rms: float
    cameras: tuple[GreyState, ...]
    krylov_iterations: int
    krylov_history: NDArray[np.float64]
    linear_error: float
    seconds: dict[str, float]

    @property
    def grey(self) -> GreyState:
        """Statistics of the first camera."""
        return self.cameras[0]


class Report(Protocol):
    """Told of every iteration on every rank; only rank 0's may speak."""

    def __call__(self, record: IterationRecord) -> None:
        """Take note of one iteration."""
        ...


@dataclass(frozen=True)
class Solution:
    """Unknowns q_s of each owned subdomain (n_unknowns,), pixels, and how they came about."""

    q: list[NDArray[np.float64]]
    records: list[IterationRecord]


def evaluate(team: Team, parts: Sequence[OwnedPart], q: Sequence[NDArray[np.float64]], correction: GreyCorrection,
             n_cameras: int = 1) -> tuple[list[tuple[Residual, ...]], tuple[GreyState, ...]]:
    """Residuals of all views of owned subdomains, and each camera's grey-level statistics; raises ConvergenceError."""
    residuals = team.together(lambda: [
        tuple(view.residual(q_s, all_kinds=correction != "none") for view in part.views)
        for part, q_s in zip(parts, q, strict=True)
    ])
    grey = team.ordered_sum([_by_camera(part, r, n_cameras, lambda r: r.sums.values)
                             for part, r in zip(parts, residuals, strict=True)])
    moments = team.ordered_sum([
        _by_camera(part, r, n_cameras, lambda r: np.stack(
            [sums.sum() for sums in r.cell_sums.sum_residual(*r.cell_sums.fit_gain_and_offset())]))
        for part, r in zip(parts, residuals, strict=True)]) if correction == "element" else None
    return residuals, tuple(
        _grey_state(GreySums(grey[k]), correction, None if moments is None else moments[k]) for k in range(n_cameras))


def _by_camera(part: OwnedPart, residuals: Sequence[Residual], n_cameras: int,
               of: Callable[[Residual], NDArray[np.float64]]) -> NDArray[np.float64]:
    """A subdomain's sums in its cameras' rows, (n_cameras, n)."""
    values = [of(residual) for residual in residuals]
    rows = np.zeros((n_cameras, len(values[0])))
    for view, value in zip(part.views, values, strict=True):
        rows[view.camera] += value
    return rows


def _grey_state(total: GreySums, correction: GreyCorrection, moments: NDArray[np.float64] | None) -> GreyState:
    """Statistics from the sums over a camera's pixels; moments: of the residual corrected by cell, (2,)."""
    gain, offset = total.fit_gain_and_offset() if correction == "global" else (np.ones(()), np.zeros(()))
    first, second = total.sum_residual(gain, offset) if moments is None else (moments[0], moments[1])
    n = float(total.n_pixels)
    if n == 0:
        raise on_all_ranks(ConvergenceError(
            "no pixel is left: every pixel of the mesh is masked or mapped outside the deformed image; "
            "check the start of the displacement and the masks"))
    mean = float(first) / n
    return GreyState(float(np.sqrt(max(second / n - mean**2, 0.0))), float(np.sqrt(second / n)), int(n),
                     float(gain), float(offset))


def right_hand_sides(parts: Sequence[OwnedPart], residuals: Sequence[tuple[Residual, ...]],
                     states: Sequence[GreyState], correction: GreyCorrection) -> list[NDArray[np.float64]]:
    """b_s of all owned subdomains, Eq. 5 of [BP17], with the grey-level correction of choice."""
    return [np.sum([view.right_hand_side(residual, *gain_and_offset(residual, states[view.camera], correction))
                    for view, residual in zip(part.views, r, strict=True)], axis=0)
            for part, r in zip(parts, residuals, strict=True)]


def gain_and_offset(residual: Residual, state: GreyState,
                    correction: GreyCorrection) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Gain and offset of f = a g + b, one number, or one per cell (n_cells,); state: of the view's camera."""
    if correction == "element":
        return residual.cell_sums.fit_gain_and_offset()
    return np.array(state.gain), np.array(state.offset)


def gauss_newton(team: Team, parts: Sequence[OwnedPart], q: Sequence[NDArray[np.float64]], step: Step,
                 correction: GreyCorrection, tolerances: Tolerances, report: Report, clock: PhaseClock,
                 n_cameras: int = 1) -> Solution:
    """Iterate q <- q + dq until the correction is small; raises ConvergenceError.

    q: start of each owned subdomain (n_unknowns,), pixels.
    """
    current = [np.array(q_s) for q_s in q]
    records: list[IterationRecord] = []
    for number in range(1, tolerances.max_iterations + 1):
        with clock.phase("residual"):
            residuals, grey = evaluate(team, parts, current, correction, n_cameras)
            b = right_hand_sides(parts, residuals, grey, correction)
        with clock.phase("linear step"):
            result, relative, rms = _linear_step(team, parts, step, current, b, tolerances, records)
        current = [q_s + dq for q_s, dq in zip(current, result.dq, strict=True)]
        records.append(IterationRecord(number, relative, rms, grey, result.krylov_iterations,
                                       result.krylov_history, result.error, dict(clock.wall)))
        report(records[-1])
        if team.on_root(partial(_decide, relative, rms, tolerances)):
            return Solution(current, records)
    last = records[-1]
    raise on_all_ranks(ConvergenceError(
        f"Gauss-Newton did not converge in {tolerances.max_iterations} iterations "
        f"(last |dq|/|q| = {last.relative:.1e}, RMS dq = {last.rms:.1e} px, "
        f"residual {last.grey.residual_std:.2f} grey levels); look at the images and the start, raise "
        "gauss_newton.max_iterations or loosen gauss_newton.tolerance, or give a longer "
        "regularization.cut_off_wavelength"))


def _linear_step(team: Team, parts: Sequence[OwnedPart], step: Step, q: Sequence[NDArray[np.float64]],
                 b: Sequence[NDArray[np.float64]], tolerances: Tolerances,
                 records: Sequence[IterationRecord]) -> tuple[StepResult, float, float]:
    """Solve for dq as far as it pays; returns the step, |dq|/|q + dq| and RMS dq in pixels."""
    last = LAST_SHARE * tolerances.rms
    guess = Leave(max(last, SHARE * GAIN * records[-1].rms)) if records else Leave(last, SHARE)
    result = step.solve(q, b, guess if tolerances.inexact else None)
    relative, rms = _sizes(team, parts, result.dq, q)
    while tolerances.inexact:
        allowed = last if _small(relative, rms, tolerances) else max(last, SHARE * rms)
        if not result.error > allowed:
            break
        tighter = step.solve(q, b, Leave(allowed))
        result = _joined(result, tighter)
        relative, rms = _sizes(team, parts, result.dq, q)
        if tighter.krylov_iterations == 0:
            break
    return result, relative, rms


def _joined(loose: StepResult, tight: StepResult) -> StepResult:
    """The tighter of two solutions of one linear step, with the iterations of both."""
    return StepResult(tight.dq, loose.krylov_iterations + tight.krylov_iterations,
                      np.concatenate([loose.krylov_history, tight.krylov_history[1:]]), tight.error)


def _sizes(team: Team, parts: Sequence[OwnedPart], dq: Sequence[NDArray[np.float64]],
           q: Sequence[NDArray[np.float64]]) -> tuple[float, float]:
    """|dq|/|q + dq| and RMS dq in pixels, every node counted once."""
    sums = team.ordered_sum([
        np.array([(dq_s[:p.n_dofs]**2 / m).sum(), ((q_s + dq_s)[:p.n_dofs]**2 / m).sum(), (1.0 / m).sum()])
        for dq_s, q_s, p, m in zip(dq, q, parts, (p.subdomain.dof_multiplicity for p in parts), strict=True)
    ])
    dim = parts[0].subdomain.mesh.dim
    if not np.isfinite(sums).all():
        return np.inf, np.inf
    relative = float(np.sqrt(sums[0] / sums[1])) if sums[1] > 0 else (0.0 if sums[0] == 0 else np.inf)
    return relative, float(np.sqrt(sums[0] / (sums[2] / dim)))


def _decide(relative: float, rms: float, tolerances: Tolerances) -> bool:
    if not np.isfinite(rms):
        raise ConvergenceError("Gauss-Newton diverged: the correction is not finite; check the start of the "
                               "displacement and the texture, or give regularization.cut_off_wavelength")
    return _small(relative, rms, tolerances)


def _small(relative: float, rms: float, tolerances: Tolerances) -> bool:
    return relative <= tolerances.relative or rms <= tolerances.rms


def silent(record: IterationRecord) -> None:
    """Report nothing."""
