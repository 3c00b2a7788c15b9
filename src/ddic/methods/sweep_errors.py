"""How candidates of a sweep are judged: by the image pair, and by virtual images whose displacement is known.

Errors of measured fields are predicted from the residuals and the degrees of freedom of all of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ddic.arrays import Array
from ddic.errors import ConvergenceError
from ddic.functionals.regularization import Material
from ddic.functionals.texture import measure_gap
from ddic.io.result_reader import Result
from ddic.methods.virtual_frames import VirtualTruth
from ddic.problem.weighted_problem import WeightedProblem
from ddic.results.measurement import Measurement
from ddic.results.publishing import gather
from ddic.results.sweep import Candidate, Trial
from ddic.solvers.probing import estimate_degrees_of_freedom, estimate_response

N_POINTS = 20_000
"""Places at which errors are taken: with some thousand independent ones among them a few per cent of each error, alike
for all candidates."""

LEAST_MEASURED = 0.95
"""Share of the places at which a candidate must measure: without those that are hardest it would look better."""


NOWHERE = np.zeros((0, 2))


def collect_trial(candidate: Candidate, problem: WeightedProblem, measurement: Measurement) -> tuple[Trial, Result]:
    """Judge what a candidate measured of the pair by residual, degrees of freedom and noise; collective.

    The field comes with the trial, both on every rank. The problem is of one camera, the measurement the last one with
    it. Raises ConvergenceError on all ranks where a linear step does not converge.
    """
    team, state = problem.team, measurement.evaluation.grey[0]
    systems, step = problem.solver.assembly.systems, problem.solver.step
    freedom = estimate_degrees_of_freedom(team, systems, step)
    counted = [~is_unmeasured for is_unmeasured in measurement.unmeasured]
    noise = state.residual_std / np.sqrt(2.0) * estimate_response(team, systems, step, counted).rms_per_grey
    result = gather(measurement)
    # A gain and an offset of each element follow noise as well.
    n_grey = 2 * result.mesh.n_cells if measurement.grey_correction == "element" else 0
    return Trial(candidate, NOWHERE, state.residual_rms, state.n_pixels, degrees_of_freedom=freedom + n_grey,
                 noise=noise), result


def draw_points(trials: Sequence[Trial], fields: Sequence[Result | None]) -> Array:
    """Draw places all over the mesh of the first field that was measured, the same at every call.

    Places are (n_points, 2), pixels. Raises ConvergenceError where no candidate measured anything.
    """
    result = next((field for field in fields if field is not None), None)
    if result is None:
        raise ConvergenceError(f"nothing that the sweep tries measures the pair: {trials[0].failure}")
    low, high = result.mesh.nodes.min(axis=0), result.mesh.nodes.max(axis=0)
    points = np.random.default_rng(0).uniform(low, high, (N_POINTS, 2))
    return np.asarray(points[np.isfinite(result.at(points)).all(axis=1)])


def evaluate_pair(trial: Trial, field: Result | None, points: Array, material: Material) -> Trial:
    """Add what a candidate measured of the pair at points, (n_points, 2), pixels, and its forces out of equilibrium."""
    if field is None:
        return replace(trial, displacement=np.full(points.shape, np.nan))
    return replace(trial, displacement=field.at(points), gap=measure_gap(field.mesh, field.displacement, material))


def evaluate_virtual(trial: Trial, result: Result | None, truth: VirtualTruth, points: Array) -> Trial:
    """Compare what a candidate measured of the virtual images with the truth at points, (n_points, 2), pixels.

    The trial gains its RMS error of a component, or why there is none; ``result`` is None where it could not be
    measured.
    """
    if result is None:
        return replace(trial, failure="the virtual images could not be measured")
    error = result.at(points) - truth.at(points)
    is_measured = np.isfinite(error).all(axis=1)
    if is_measured.mean() < LEAST_MEASURED:
        return replace(trial, failure=f"of the virtual images only {100 * is_measured.mean():.0f} % could be measured")
    return replace(trial, virtual_error=float(np.sqrt((error[is_measured] ** 2).mean())))


@dataclass(frozen=True)
class PairNoise:
    """Noise of an image pair, as the finest fields leave it.

    Attributes
    ----------
    variance : float
        Of the residual, for each pixel that no unknown follows, grey levels squared.
    transfer : float
        Share of the deformed image's variance that interpolation leaves (``average_noise_transfer``).
    """

    variance: float
    transfer: float

    @property
    def camera(self) -> float:
        """Standard deviation of one image's noise, grey levels."""
        return float(np.sqrt(self.variance / (1.0 + self.transfer)))

    @property
    def of_field(self) -> float:
        """Variance of both images, which reaches the field, grey levels squared."""
        # Interpolation takes the finest part of the deformed image's, which speckle does not feel.
        return 2.0 * self.camera**2


def estimate_pair_noise(trials: Sequence[Trial], transfer: float) -> PairNoise:
    """Estimate the noise of a pair: the least residual, each unknown having followed as much as one pixel's.

    Trials that failed do not count. ``transfer`` is what interpolation leaves of the variance of noise.
    """
    variances = [trial.residual**2 * trial.n_pixels / max(trial.n_pixels - trial.degrees_of_freedom, 1.0)
                 for trial in trials if not trial.failure]
    return PairNoise(min(variances), transfer)


def predict_errors(trials: Sequence[Trial], noise: PairNoise, mean_square_gradient: float) -> list[Trial]:
    """Predict the error of each field by Stein's unbiased estimate: residual and degrees of freedom.

    The residual of a field grows by what it lacks of the displacement and shrinks by the noise that it follows, 2
    sigma^2 tr(A^-1 M) more than the error does. Relative to the field of most degrees of freedom, whose error is taken
    to be noise alone, what all residuals have in common falls out (interpolation, rounding).

    ``mean_square_gradient`` is that of the reference image, both components together, grey levels squared per square
    pixel. Predicted errors are RMS of a component, pixels, weighted by the texture. Where noise makes the square
    negative, so is its root: the order remains.
    """
    finest = max((trial for trial in trials if not trial.failure), key=lambda trial: trial.degrees_of_freedom)
    predicted = []
    for trial in trials:
        if trial.failure:
            predicted.append(trial)
            continue
        n = trial.n_pixels
        # Of as many pixels, where one excludes more than the other.
        excess = n * (trial.residual**2 - finest.residual**2)
        followed = noise.of_field * (2.0 * trial.degrees_of_freedom - finest.degrees_of_freedom)
        square = (excess + followed) / (n * mean_square_gradient)
        predicted.append(replace(trial, predicted_error=_root(square)))
    return predicted


def correct_predictions(trials: Sequence[Trial], known: int) -> list[Trial]:
    """Shift all squares of predicted errors alike, so that one trial's is its error on the virtual images.

    The residual tells apart errors of a few per cent of the noisiest field's; how large all of them are together it
    tells no better than the texture is even. ``known`` is the number of the trial whose field the virtual images have;
    nothing is shifted where that trial has no error on them.
    """
    anchor = trials[known]
    if not np.isfinite(anchor.virtual_error):
        return list(trials)
    offset = anchor.virtual_error**2 - _square(anchor.predicted_error)
    return [replace(trial, predicted_error=_root(_square(trial.predicted_error) + offset)) for trial in trials]


def _square(error: float) -> float:
    return float(np.sign(error)) * error**2


def _root(square: float) -> float:
    return float(np.sign(square) * np.sqrt(abs(square)))
