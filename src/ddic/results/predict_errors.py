"""Errors of measured fields, as the residuals and the degrees of freedom of all of them predict them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ddic.results.sweep_trials import Trial


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

    Parameters
    ----------
    trials : sequence of Trial
        Of the pair; those that failed do not count.
    transfer : float
        What interpolation leaves of the variance of noise.

    Returns
    -------
    PairNoise
        Of both images.
    """
    variances = [trial.residual**2 * trial.n_pixels / max(trial.n_pixels - trial.degrees_of_freedom, 1.0)
                 for trial in trials if not trial.failure]
    return PairNoise(min(variances), transfer)


def predict_errors(trials: Sequence[Trial], noise: PairNoise, mean_square_gradient: float) -> list[Trial]:
    """Predict the error of each field by Stein's unbiased estimate: residual and degrees of freedom.

    The residual of a field grows by what it lacks of the displacement and shrinks by the noise that it follows,
    2 sigma^2 tr(A^-1 M) more than the error does. Relative to the field of most degrees of freedom, whose error is
    taken to be noise alone, what all residuals have in common falls out (interpolation, rounding).

    Parameters
    ----------
    trials : sequence of Trial
        Of the pair.
    noise : PairNoise
        Of the images.
    mean_square_gradient : float
        Of the reference image, both components together, grey levels squared per square pixel.

    Returns
    -------
    list of Trial
        With predicted errors: RMS of a component, pixels, weighted by the texture. Where noise makes the square
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
    tells no better than the texture is even.

    Parameters
    ----------
    trials : sequence of Trial
        With both errors.
    known : int
        Number of the trial whose field the virtual images have.

    Returns
    -------
    list of Trial
        With other predicted errors; the same where that trial has no error on the virtual images.
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
