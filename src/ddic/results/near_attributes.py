"""What the result file and the summary say of a near-field set-up."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ddic.results.provenance import describe_image
from ddic.results.setup_motion import SetupMotion
from ddic.results.summary import NearSummary

if TYPE_CHECKING:
    from ddic.results.measurement import Measurement


def describe_near_field(measurement: Measurement, motion: SetupMotion) -> dict[str, Any]:
    """Describe motion, mapping, noise and images of a near field; lengths are pixels of the far field.

    Parameters
    ----------
    measurement : Measurement
        What was measured.
    motion : SetupMotion
        Of the near field.

    Returns
    -------
    dict
        Attributes by name.
    """
    setup, number = motion.setup, motion.camera
    grey = measurement.evaluation.grey[number]
    reference, deformed = measurement.cameras[number].reference.image, measurement.frame[number].image
    return {
        "alpha_px": motion.alpha, "theta_rad": motion.theta, "covariance": motion.covariance,
        "centre_px": setup.centre, "lever_px": setup.length, "motion": setup.motion,
        "homography": setup.mapping.homography, "distortion_centre_px": setup.mapping.centre,
        "distortion_radius_px": setup.mapping.radius, "radial": setup.mapping.radial,
        "noise_grey": measurement.noise[number], "far_noise_grey": measurement.noise[0],
        "residual_std_grey": grey.residual_std, "gain": grey.gain, "offset": grey.offset,
        **describe_image("reference", reference), **describe_image("deformed", deformed),
    }


def summarize_near_field(measurement: Measurement, motion: SetupMotion) -> NearSummary:
    """Say the same to scripts and people, in short.

    Parameters
    ----------
    measurement : Measurement
        What was measured.
    motion : SetupMotion
        Of the near field.

    Returns
    -------
    NearSummary
        With standard deviations.
    """
    deviations = np.sqrt(np.diag(motion.covariance))
    return NearSummary(
        alpha_px=(float(motion.alpha[0]), float(motion.alpha[1])),
        alpha_std_px=(float(deviations[0]), float(deviations[1])),
        theta_rad=motion.theta,
        theta_std_rad=float(deviations[2]) if len(deviations) == 3 else 0.0,
        residual_std_grey=measurement.evaluation.grey[motion.camera].residual_std,
        noise_grey=measurement.noise[motion.camera],
    )
