"""The noise of the images from which the noise of a field follows: given, of images at rest, or of the residual."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError, as_collective
from ddic.images.rest_noise import BLOCK, estimate_rest_noise
from ddic.images.window import Window
from ddic.io.image_file import hold_image
from ddic.problem.noise_forces import find_white_transfer
from ddic.problem.residual_model import Evaluation, ResidualModel
from ddic.problem.weighted_problem import WeightedProblem

Array = NDArray[np.float64]

GIVEN, OF_REST, OF_RESIDUAL = "given", "of the images at rest", "estimated from the residual"


@dataclass(frozen=True)
class ImageNoise:
    """The noise of each camera's images.

    Attributes
    ----------
    sigma : tuple of float
        Its standard deviation, by camera, grey levels.
    origin : str
        Where the first camera's comes from.
    """

    sigma: tuple[float, ...]
    origin: str


def find_image_noise(problem: WeightedProblem, model: ResidualModel, evaluation: Evaluation,
                     q: Sequence[Array]) -> ImageNoise:
    """Find the noise of the images; collective.

    Parameters
    ----------
    problem : WeightedProblem
        Of the reference images.
    model : ResidualModel
        The pixels that count.
    evaluation : Evaluation
        At the field.
    q : sequence of (n_unknowns,) array
        The field of each owned subdomain.

    Returns
    -------
    ImageNoise
        Given, else that of the images at rest, else of the residual; of several cameras that by which they are
        weighted.
    """
    inputs = problem.reference.inputs
    given = inputs.cameras[0].noise
    if problem.noise:
        return ImageNoise(problem.noise, OF_RESIDUAL if given is None else GIVEN)
    if given is not None:
        return ImageNoise((given,), GIVEN)
    if inputs.case.images.at_rest is not None:
        return ImageNoise((_measure_at_rest(problem, inputs.case.images.at_rest),), OF_REST)
    return ImageNoise((estimate_from_residual(model, evaluation, q, inputs.case.correlation.spline_degree),),
                      OF_RESIDUAL)


def estimate_from_residual(model: ResidualModel, evaluation: Evaluation, q: Sequence[Array], degree: int) -> float:
    """Estimate the noise of one camera's images from what the field leaves of grey-level conservation; collective.

    Of every cell the mean square of f - a g - b is sigma^2 (1 + a^2 c), c the spline's noise transfer; the median over
    cells passes over those where the field does not follow the specimen.

    Parameters
    ----------
    model : ResidualModel
        The pixels that count.
    evaluation : Evaluation
        At the field.
    q : sequence of (n_unknowns,) array
        The field of each owned subdomain.
    degree : int
        Of the spline, 3 or 5.

    Returns
    -------
    float
        Standard deviation, grey levels; 0 where no pixel counts.
    """
    found = []
    for residuals, transfers in zip(evaluation.residuals, find_white_transfer(model, q, degree), strict=True):
        own, transfer = residuals[0], transfers[0]
        gain, offset = model.find_correction(evaluation, 0, own)
        _, squares = own.cell_sums.sum_residual(gain, offset)
        n = own.cell_sums.n_pixels
        with np.errstate(invalid="ignore", divide="ignore"):
            # The median of a mean of n squares is below their expectation (Wilson and Hilferty, PNAS 17, 1931).
            variances = squares / n / (1.0 + gain**2 * transfer) / (1.0 - 2.0 / (9.0 * n)) ** 3
        found.append(variances[n > 1])
    everywhere = np.concatenate(model.team.gather_lists(found))
    return float(np.sqrt(np.median(everywhere))) if len(everywhere) else 0.0


def _measure_at_rest(problem: WeightedProblem, path: Path) -> float:
    """Noise of the reference image and another one of the specimen as it is there; collective."""
    team, reference = problem.team, problem.reference.inputs.cameras[0].reference.image
    boxes = team.gather_lists([(s.mesh.nodes.min(axis=0), s.mesh.nodes.max(axis=0))
                               for s in problem.reference.subdomains])
    low = np.min([box[0] for box in boxes], axis=0).astype(int)
    high = np.max([box[1] for box in boxes], axis=0).astype(int)
    window = Window(low[0], low[1], high[0], high[1]).clip(reference.width, reference.height)
    noise = team.on_root(lambda: estimate_rest_noise(reference, hold_image(path), window))
    if not np.isfinite(noise):
        raise as_collective(InputError(f"images.at_rest: {path}: the mesh covers fewer than {BLOCK} x {BLOCK} px, from "
                                       "which no noise can be told; give images.noise"))
    return noise
