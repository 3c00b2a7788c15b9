"""Successive corrections of a separated displacement, each followed by a new residual: Fig. 2 of [PP12]."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ddic.arrays import Array
from ddic.errors import ConvergenceError
from ddic.functionals.grey_statistics import GreyCorrection, GreyState, GreySums, measure_deviation
from ddic.separated.field import LineElements, SeparatedField
from ddic.separated.pixel_bands import FramePixels
from ddic.separated.rank_one import Mode, build_directions, find_rank_one, renew_functions
from ddic.separated.separated_regularization import SeparatedOperator, build_no_operator

OF_GAP, OF_TIKHONOV = 1.4, 1.9
"""Functions that a regularisation lets through, per cut-off wavelength along a side: 1.1 to 1.45 and 1.1 to 1.9 were
measured on speckle with noise, on elements of 1 to 32 px and wavelengths of 16 to 128 px. A larger value ends
corrections earlier."""


def estimate_noise_gain(along_x: LineElements, along_y: LineElements, density: float | None,
                        residual_rms: float) -> float:
    """Predict by how much the best rank-one correction of noise lowers half the sum of squared residuals.

    Seen with M^(-1/2), noise is a random matrix of n_x by n_y independent entries for each component, whose largest
    singular value is sqrt(n_x) + sqrt(n_y) of their standard deviation. Regularisation leaves as many functions as
    waves fit into a side: ``density`` of them per pixel, None without regularisation. ``residual_rms`` is taken for
    noise. Grey levels squared; 0.76 to 0.9 of it were measured on noise without regularisation.
    """
    n_x, n_y = (_count_functions(line, density) for line in (along_x, along_y))
    # Half of the square of the largest singular value, for each of two components.
    return residual_rms**2 * float(np.sqrt(n_x) + np.sqrt(n_y)) ** 2


def _count_functions(line: LineElements, density: float | None) -> float:
    """Functions of one direction that pixels determine."""
    n = float(min(line.n_nodes, len(line.pixels)))
    return n if density is None else min(n, 1.0 + density * line.length)


MOST_MODES = 24
"""Modes from which on they are written anew as orthogonal ones; a larger value makes displacements costlier."""

LOSS_PX = 1e-7
"""RMS displacement that this may lose."""

LEAST_CORRELATION = 0.5
"""Correlation coefficient of f and g(x + u) below which a residual that looks like noise is that of a bad start."""

_TINY = 1e-300
"""A size below any that is not 0."""


@dataclass(frozen=True)
class StoppingRules:
    """When corrections end.

    Attributes
    ----------
    tolerance : float
        RMS of a correction, component by component, relative to the component without its mean.
    rms_tolerance : float
        The same, pixels: a component that hardly moves meets this one.
    max_corrections : int
        After which the measurement fails.
    stops_at_noise : bool
        Whether corrections end where one fits the images no better than it would fit noise.
    """

    tolerance: float = 1e-3
    rms_tolerance: float = 1e-4
    max_corrections: int = 200
    stops_at_noise: bool = True


@dataclass(frozen=True)
class Scheme:
    """How corrections are found.

    Attributes
    ----------
    max_sweeps, stagnation : int, float
        k_max and e of the fixed point.
    update : bool
        Whether all functions of one direction are found anew after each mode, in turn those of x and of y.
    correction : GreyCorrection
        Of grey levels: "none" or "global".
    """

    max_sweeps: int = 6
    stagnation: float = 0.05
    update: bool = False
    correction: GreyCorrection = "none"


@dataclass(frozen=True, eq=False)
class Regularization:
    """What is added to half the sum of squared residuals: 1/2 weight u^T L u.

    Attributes
    ----------
    operator : SeparatedOperator
        weight L.
    weight : float
        eta, in grey levels squared over pixels squared and the unit of L.
    density : float
        Functions per pixel of a side that it lets through.
    """

    operator: SeparatedOperator
    weight: float
    density: float


@dataclass(frozen=True)
class CorrectionRecord:
    """What is known of one correction; the residual is that before it.

    Attributes
    ----------
    number : int
        From 1.
    rms : (x, y)
        RMS of the correction, what the update changed included, pixels.
    relative : (x, y)
        The same over the RMS of the displacement with the correction.
    fluctuation : (x, y)
        The same over the RMS of the displacement without its mean, which decides.
    gain, noise_gain : float
        Decrease of half the sum of squares that the correction promises, and that a correction fitted to noise of the
        residual's level would; grey levels squared.
    n_sweeps : int
        Of the fixed point.
    grey : GreyState
        Residual.
    n_modes : int
        Of the displacement after the correction.
    eta : float
        ``relative`` of both components together, as in section 3.3 of [PP12].
    stagnation : float
        e of the fixed point in its last sweep, Eq. (25) of [PP12]; nan after a single one.
    """

    number: int
    rms: tuple[float, float]
    relative: tuple[float, float]
    fluctuation: tuple[float, float]
    gain: float
    noise_gain: float
    n_sweeps: int
    grey: GreyState
    n_modes: int
    eta: float
    stagnation: float


@dataclass(frozen=True, eq=False)
class SeparatedSolution:
    """A displacement and how it was found.

    Attributes
    ----------
    field : SeparatedField
        u, of orthogonal modes, largest first.
    records : list of CorrectionRecord
        Of all corrections.
    grey : GreyState
        Residual at u.
    sums : GreySums
        Over all pixels, at u.
    stop : str
        Why corrections ended.
    """

    field: SeparatedField
    records: list[CorrectionRecord]
    grey: GreyState
    sums: GreySums
    stop: str


def correct_displacement(pixels: FramePixels, start: SeparatedField, regularization: Regularization | None,
                         scheme: Scheme, rules: StoppingRules,
                         note: Callable[[CorrectionRecord], None]) -> SeparatedSolution:
    """Correct a displacement mode by mode until it converges, or noise is all that is left.

    ``note`` is told every correction; a ConvergenceError that it raises ends the corrections. Raises ConvergenceError,
    with the last SeparatedSolution, where neither rule is met after ``max_corrections``, noise is all that is left of
    images that do not match, or ``note`` raises it; SingularSubdomainError where the images do not determine a
    correction.
    """
    operator, density = build_no_operator(start.along_x, start.along_y), None
    if regularization is not None:
        operator, density = regularization.operator, regularization.density
    u, records, stop = start, list[CorrectionRecord](), ""
    sums, grey = _evaluate(pixels, u, scheme.correction)
    while not stop:
        if len(records) == rules.max_corrections:
            raise ConvergenceError(_describe_failure(records, rules), SeparatedSolution(u, records, grey, sums, ""))
        mode = find_rank_one(pixels, build_directions(pixels, operator, u), scheme.max_sweeps, scheme.stagnation)
        noise_gain = estimate_noise_gain(start.along_x, start.along_y, density, grey.residual_rms)
        if rules.stops_at_noise and mode.gain <= noise_gain:
            _require_match(SeparatedSolution(u, records, grey, sums, ""))
            stop = f"noise: a further correction would fit the images no better than noise ({mode.gain:.3g} <= " \
                   f"{noise_gain:.3g} grey levels squared)"
            break
        before, u = u, _add_mode(pixels, operator, u, mode, len(records) if scheme.update else None)
        rms = u.measure_difference(before) if scheme.update else mode.field.measure_rms()
        record = _describe(len(records) + 1, mode, rms, u, noise_gain, grey)
        records.append(record)
        sums, grey = _evaluate(pixels, u, scheme.correction)
        _tell(note, SeparatedSolution(u, records, grey, sums, ""))
        stop = pixels.reference.sums.broadcast(_find_stop(record, rules))
    return SeparatedSolution(u.reduce_modes(LOSS_PX), records, grey, sums, stop)


def _tell(note: Callable[[CorrectionRecord], None], found: SeparatedSolution) -> None:
    """Tell the last correction; whoever is told may end the measurement, which then keeps what was found."""
    try:
        note(found.records[-1])
    except ConvergenceError as error:
        error.last = found
        raise


def _evaluate(pixels: FramePixels, u: SeparatedField, correction: GreyCorrection) -> tuple[GreySums, GreyState]:
    """The residual at u, grey levels corrected as asked."""
    sums = pixels.evaluate(u)
    if not sums.n_pixels:
        raise ConvergenceError("no pixel of the region is displaced into the deformed image; look at the start")
    gain, offset = (1.0, 0.0)
    if correction == "global":
        gain, offset = (float(value) for value in sums.fit_gain_and_offset())
        pixels.correct_grey_levels(gain, offset)
    first, second = sums.sum_residual(gain, offset)
    n = float(sums.n_pixels)
    return sums, GreyState(*measure_deviation(n, first, second), int(n), gain, offset)


def _add_mode(pixels: FramePixels, operator: SeparatedOperator, u: SeparatedField, mode: Mode,
              n_before: int | None) -> SeparatedField:
    """U with a mode; with ``n_before`` corrections before it, functions of one direction are found anew."""
    if n_before is not None:
        return renew_functions(pixels, operator, u, mode.field, along_y=n_before % 2 == 1, loss=LOSS_PX)
    added = u.add(mode.field)
    return added if added.n_modes <= MOST_MODES else added.reduce_modes(LOSS_PX)


def _describe(number: int, mode: Mode, rms: Array, u: SeparatedField, noise_gain: float,
              grey: GreyState) -> CorrectionRecord:
    sizes, fluctuations = u.measure_rms(), u.measure_rms(without_mean=True)

    def relative(to: Array) -> tuple[float, float]:
        found = rms / np.maximum(to, _TINY)
        return float(found[0]), float(found[1])

    eta = float(np.linalg.norm(rms)) / max(float(np.linalg.norm(sizes)), _TINY)
    return CorrectionRecord(number, (float(rms[0]), float(rms[1])), relative(sizes), relative(fluctuations), mode.gain,
                            noise_gain, mode.n_sweeps, grey, u.n_modes, eta, mode.stagnation)


def _find_stop(record: CorrectionRecord, rules: StoppingRules) -> str:
    """Which tolerance both components meet; nothing where one does not."""
    met = []
    for rms, relative in zip(record.rms, record.fluctuation, strict=True):
        if relative <= rules.tolerance:
            met.append(f"{relative:.1e} of its displacement")
        elif rms <= rules.rms_tolerance:
            met.append(f"{rms:.1e} px")
        else:
            return ""
    return f"converged: the last correction is {met[0]} along x, {met[1]} along y"


def _require_match(found: SeparatedSolution) -> None:
    """Raise ConvergenceError where what looks like noise are images that do not match."""
    n, r, g, rr, gg, rg = (float(value) for value in found.sums.values)
    of_f = rr + 2 * rg + gg - (r + g) ** 2 / n
    of_g = gg - g**2 / n
    product = gg + rg - (r + g) * g / n
    coefficient = product / np.sqrt(max(of_f * of_g, _TINY))
    if coefficient < LEAST_CORRELATION:
        raise ConvergenceError(f"no correction fits the images better than noise, yet they do not match (correlation "
                               f"coefficient {coefficient:.2f}): the start is too far off; see [start], or measure "
                               "a frame between the two first", found)


def _describe_failure(records: list[CorrectionRecord], rules: StoppingRules) -> str:
    last = records[-1]
    end_at_noise = "" if rules.stops_at_noise else ", pgd.stop_at_noise = true"
    return (f"PGD-DIC does not converge: after {rules.max_corrections} corrections the last one is {last.rms[0]:.1e} "
            f"px along x and {last.rms[1]:.1e} px along y (pgd.tolerance = {rules.tolerance:g}, pgd.rms_tolerance = "
            f"{rules.rms_tolerance:g}); give a larger pgd.tolerance{end_at_noise}, larger elements, [regularization], "
            "or more pgd.max_corrections")
