"""Trials of a sweep, from what each candidate measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ddic.errors import ConvergenceError
from ddic.functionals.regularization import Material
from ddic.functionals.texture import measure_gap
from ddic.io.result_reader import Result
from ddic.results.candidate_field import CandidateField
from ddic.results.sweep_trials import Candidate, Trial
from ddic.results.virtual_truth import VirtualTruth

Array = NDArray[np.float64]

N_POINTS = 20_000
"""Places at which errors are taken: with some thousand independent ones among them a few per cent of each error, alike
for all candidates."""

LEAST_MEASURED = 0.95
"""Share of the places at which a candidate must measure: without those that are hardest it would look better."""


def draw_points(fields: Sequence[CandidateField]) -> Array:
    """Draw places all over the mesh of the first field that was measured, the same at every call.

    Parameters
    ----------
    fields : sequence of CandidateField
        Of all candidates.

    Returns
    -------
    (n_points, 2) array
        Pixels.

    Raises
    ------
    ConvergenceError
        Where no candidate measured anything.
    """
    result = next((field.result for field in fields if field.result is not None), None)
    if result is None:
        raise ConvergenceError(f"nothing that the sweep tries measures the pair: {fields[0].failure}")
    low, high = result.mesh.nodes.min(axis=0), result.mesh.nodes.max(axis=0)
    points = np.random.default_rng(0).uniform(low, high, (N_POINTS, 2))
    return np.asarray(points[np.isfinite(result.at(points)).all(axis=1)])


def evaluate_pair(candidate: Candidate, field: CandidateField, points: Array, material: Material) -> Trial:
    """Judge what a candidate measured of the pair.

    Parameters
    ----------
    candidate : Candidate
        What was tried.
    field : CandidateField
        What was measured.
    points : (n_points, 2) array
        Where, pixels.
    material : Material
        By which the forces out of equilibrium are computed.

    Returns
    -------
    Trial
        Without errors.
    """
    if field.result is None:
        return Trial(candidate, np.full(points.shape, np.nan), failure=field.failure)
    gap = measure_gap(field.result.mesh, field.result.displacement, material)
    return Trial(candidate, field.result.at(points), field.residual, field.n_pixels, gap, field.degrees_of_freedom,
                 field.noise)


def evaluate_virtual(trial: Trial, result: Result | None, truth: VirtualTruth, points: Array) -> Trial:
    """Compare what a candidate measured of the virtual images with the truth.

    Parameters
    ----------
    trial : Trial
        Of the candidate.
    result : Result or None
        What it measured; None where it could not.
    truth : VirtualTruth
        The displacement of the virtual images.
    points : (n_points, 2) array
        Where, pixels.

    Returns
    -------
    Trial
        With its RMS error of a component, or why there is none.
    """
    if result is None:
        return replace(trial, failure="the virtual images could not be measured")
    error = result.at(points) - truth.at(points)
    is_measured = np.isfinite(error).all(axis=1)
    if is_measured.mean() < LEAST_MEASURED:
        return replace(trial, failure=f"of the virtual images only {100 * is_measured.mean():.0f} % could be measured")
    return replace(trial, virtual_error=float(np.sqrt((error[is_measured] ** 2).mean())))
