"""What the result file says of a near-field set-up."""

from __future__ import annotations

from typing import Any

import numpy as np

from ddic.methods.dd_dic import Measurement
from ddic.problem.setup_motion import SetupMotion
from ddic.results.provenance import image_attributes
from ddic.results.summary import NearSummary


def near_attributes(measurement: Measurement, motion: SetupMotion) -> dict[str, Any]:
    """Motion, mapping, noise and images of a near field; lengths are pixels of the far field."""
    rig, pair, grey = motion.rig, measurement.pairs[motion.camera], measurement.grey[motion.camera]
    return {
        "alpha_px": motion.alpha, "theta_rad": motion.theta, "covariance": motion.covariance,
        "centre_px": rig.centre, "lever_px": rig.length, "motion": rig.motion,
        "homography": rig.mapping.homography, "distortion_centre_px": rig.mapping.centre,
        "distortion_radius_px": rig.mapping.radius, "radial": rig.mapping.radial,
        "noise_grey": measurement.noise[motion.camera], "far_noise_grey": measurement.noise[0],
        "residual_std_grey": grey.residual_std, "gain": grey.gain, "offset": grey.offset,
        **image_attributes("reference", pair.reference.image), **image_attributes("deformed", pair.deformed.image),
    }


def near_summary(measurement: Measurement, motion: SetupMotion) -> NearSummary:
    """The same for scripts and people, in short."""
    deviations = np.sqrt(np.diag(motion.covariance))
    return NearSummary(
        alpha_px=(float(motion.alpha[0]), float(motion.alpha[1])),
        alpha_std_px=(float(deviations[0]), float(deviations[1])),
        theta_rad=motion.theta,
        theta_std_rad=float(deviations[2]) if len(deviations) == 3 else 0.0,
        residual_std_grey=measurement.grey[motion.camera].residual_std,
        noise_grey=measurement.noise[motion.camera],
    )
