"""The noise of each camera, given or estimated from the residual, by which several cameras are weighted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ddic.functionals.grey_statistics import GreyCorrection
from ddic.functionals.view import FrameView
from ddic.parallel.team import Team
from ddic.problem.cameras import Camera
from ddic.problem.residual_model import Evaluation, ResidualModel
from ddic.problem.views import FrameViews, ReferenceViews

ROUNDING = 0.29
"""Standard deviation of the rounding to whole grey levels: no estimate of an image of integers is below it."""

SMALLEST_SHARE = 1e-4
"""Share of the range of its grey levels below which no estimate of a camera's noise is, whatever their unit: no camera
tells ten thousand of them apart. A larger value gives a camera without noise less weight."""


def estimate_noise(team: Team, cameras: Sequence[Camera], views: Sequence[FrameViews],
                   fields: Sequence[NDArray[np.float64]], correction: GreyCorrection) -> list[float]:
    """Find the noise of each camera: given, or its residual's standard deviation over sqrt(2); collective.

    Of a camera's subdomains the one in the middle counts: some may not have been measured well by themselves.

    Parameters
    ----------
    team : Team
        All ranks.
    cameras : sequence of Camera
        All of them.
    views : sequence of FrameViews
        Owned subdomains in the frame.
    fields : sequence of (n_field,) array
        Field of each, as its own camera alone sees it.
    correction : GreyCorrection
        Of grey levels.

    Returns
    -------
    list of float
        Standard deviation of each camera's noise, grey levels.
    """
    alone = [_by_own_camera(of_subdomain) for of_subdomain in views]
    model = ResidualModel(team, alone, correction, len(cameras))
    evaluation = model.evaluate(fields)
    deviations = team.gather_lists([(of_subdomain.subdomain.camera, _deviation(model, evaluation, k))
                                    for k, of_subdomain in enumerate(alone)])
    ranges = team.gather_lists([(of_subdomain.subdomain.camera, *of_subdomain.reference.own.measure_grey_range())
                                for of_subdomain in alone])
    noise = []
    for camera in cameras:
        of_camera = [std for number, std in deviations if number == camera.number]
        # The residual has the noise of two images.
        estimated = float(np.median(of_camera)) / np.sqrt(2)
        lowest = min(low for number, low, _ in ranges if number == camera.number)
        highest = max(high for number, _, high in ranges if number == camera.number)
        smallest = max(SMALLEST_SHARE * (highest - lowest), _rounding(camera))
        noise.append(max(estimated, smallest) if camera.noise is None else camera.noise)
    return noise


def _rounding(camera: Camera) -> float:
    """Standard deviation of the rounding of a camera's grey levels; floats need not be rounded."""
    return 0.0 if camera.reference.image.saturation is None else ROUNDING


def describe_noise(cameras: Sequence[Camera], noise: Sequence[float]) -> tuple[str, ...]:
    """Say what noise each camera has.

    Parameters
    ----------
    cameras : sequence of Camera
        All of them.
    noise : sequence of float
        Of each, grey levels.

    Returns
    -------
    tuple of str
        A line for each.
    """
    lines = []
    for camera, sigma in zip(cameras, noise, strict=True):
        origin = "estimated from the residual" if camera.noise is None else "given"
        lines.append(f"{camera.label}: noise of {sigma:.2f} grey levels ({origin})")
    return tuple(lines)


def _by_own_camera(of_subdomain: FrameViews) -> FrameViews:
    """The same by its own camera, which keeps its number, in a set-up that does not move."""
    alone = of_subdomain.reference.alone()
    own = of_subdomain.reference.own.hold_still()
    return FrameViews(ReferenceViews(alone.subdomain, (own,)), (FrameView(own, of_subdomain.views[0].deformed),))


def _deviation(model: ResidualModel, evaluation: Evaluation, place: int) -> float:
    """Standard deviation of a subdomain's residual, grey levels."""
    residual = evaluation.residuals[place][0]
    camera = model.views[place].views[0].camera
    first, second = residual.cell_sums.sum_residual(*model.find_correction(evaluation, camera, residual))
    n_pixels = max(float(residual.sums.n_pixels), 1.0)
    mean = first.sum() / n_pixels
    variance = second.sum() / n_pixels - mean**2
    # Rounding may leave a variance of nothing below zero.
    return float(np.sqrt(max(variance, 0.0)))
