"""What the result file and the summary say of a near-field set-up; its measured motion and the covariance of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ddic.arrays import Array
from ddic.inputs.cameras import Camera
from ddic.kinematics.camera import CameraSetup
from ddic.parallel.field import Field
from ddic.parallel.team import Team
from ddic.partition.subdomain import Subdomain
from ddic.problem.weighted_problem import WeightedProblem
from ddic.results.publishing import describe_image
from ddic.results.summary import NearSummary
from ddic.solvers.dual.dual_problem import sum_motion_scales
from ddic.solvers.linear_step import AllowedError, LinearStep
from ddic.solvers.local_system import LocalSystem

if TYPE_CHECKING:
    from ddic.results.measurement import Measurement


ENOUGH = AllowedError(1e-4)
"""Error of a field of about a pixel that is left in what makes the covariance: four digits of it."""


@dataclass(frozen=True)
class SetupMotion:
    """Measured motion of a near-field set-up between its pictures, T(Y) = X0 + R(theta) (Y - X0) + alpha.

    Attributes
    ----------
    camera : int
        Its number.
    setup : CameraSetup
        phi and X0.
    alpha : (2,) array
        Pixels of the far image.
    theta : float
        Radians, 0 where it was not asked for.
    covariance : (2, 2) or (3, 3) array
        Of (alpha_x, alpha_y) or (alpha_x, alpha_y, theta), pixels and radians.
    """

    camera: int
    setup: CameraSetup
    alpha: Array
    theta: float
    covariance: Array


def measure_motions(problem: WeightedProblem, q: Field) -> tuple[SetupMotion, ...]:
    """Measure how set-ups have moved in a field, of the cameras whose set-up may move; collective."""
    team, solver, cameras = problem.team, problem.solver, problem.reference.inputs.cameras
    if not any(camera.setup.n_motion_unknowns for camera in cameras):
        return ()
    covariances = estimate_covariances(team, solver.assembly.systems, solver.step, problem.noise[0])
    return describe_motions(cameras, collect_motions(team, cameras, problem.reference.subdomains, q), covariances)


def estimate_covariances(team: Team, systems: Sequence[LocalSystem], step: LinearStep,
                         noise: float) -> dict[int, Array]:
    """Estimate the covariance of every moving set-up's unknowns from the noise of the images; collective.

    The columns x = A^-1 e of the unknowns give 2 sigma^2 x^T M x: b has the covariance 2 sigma^2 M, since noise is in
    both pictures and M is weighted by the noise. ``noise`` is sigma of the first camera, grey levels. Returns, by
    camera, (n_motion_unknowns, n_motion_unknowns) arrays, pixels squared.
    """
    found = {}
    for camera, scale in sum_motion_scales(team, systems).items():
        columns = [_solve_for_unit(team, systems, step, camera, k, kappa) for k, kappa in enumerate(scale)]
        products = [np.stack([x[s] for x in columns], axis=1) for s in range(len(systems))]
        total = team.ordered_sum([x.T @ (system.hessian @ x) for x, system in zip(products, systems, strict=True)])
        found[camera] = 2 * noise**2 * total
    return found


def _solve_for_unit(team: Team, systems: Sequence[LocalSystem], step: LinearStep, camera: int, k: int,
                    kappa: float) -> Field:
    """A^-1 e of one unknown of a camera's motion."""
    # As large as what moves the set-up by about a pixel: steps start from their last solution.
    at_rest = Field.zero(team, [system.subdomain for system in systems])
    b = at_rest.map(lambda subdomain, _: kappa * _unit_force(subdomain, camera, k))
    return step.solve(at_rest, b, ENOUGH).dq / kappa


def _unit_force(subdomain: Subdomain, camera: int, k: int) -> Array:
    """A unit right-hand side of one unknown of a camera's motion, on the one subdomain that owns it."""
    b = np.zeros(subdomain.n_unknowns)
    if subdomain.motion is not None and subdomain.motion.owned and subdomain.camera == camera:
        b[subdomain.n_field + k] = 1.0
    return b


def collect_motions(team: Team, cameras: Sequence[Camera], subdomains: Sequence[Subdomain],
                    q: Sequence[Array]) -> list[Array]:
    """Collect the unknowns of each camera's motion, (n_motion_unknowns,), on all ranks; collective."""
    mine = [(s.camera, q_s[s.n_field:]) for s, q_s in zip(subdomains, q, strict=True)]
    found = dict(team.gather_lists(mine))
    return [found.get(camera.number, np.zeros(camera.setup.n_motion_unknowns)) for camera in cameras]


def describe_motions(cameras: Sequence[Camera], motions: Sequence[Array],
                     covariances: dict[int, Array]) -> tuple[SetupMotion, ...]:
    """Convert motions, (n_motion_unknowns,) of each camera, and covariances to px and rad, where a set-up may move."""
    described = []
    for camera, motion in zip(cameras, motions, strict=True):
        setup = camera.setup
        n = setup.n_motion_unknowns
        if n == 0:
            continue
        units = np.array([1.0, 1.0, 1.0 / setup.length])[:n]
        alpha = motion[:2]
        theta = float(motion[2]) / setup.length if n == 3 else 0.0
        covariance = covariances[camera.number] * np.outer(units, units)
        described.append(SetupMotion(camera.number, setup, alpha, theta, covariance))
    return tuple(described)


def describe_near_field(measurement: Measurement, motion: SetupMotion) -> dict[str, Any]:
    """Describe motion, mapping, noise and images of a near field; lengths are pixels of the far field."""
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
    """Say the same to scripts and people, in short, with standard deviations."""
    deviations = np.sqrt(np.diag(motion.covariance))
    return NearSummary(
        alpha_px=(float(motion.alpha[0]), float(motion.alpha[1])),
        alpha_std_px=(float(deviations[0]), float(deviations[1])),
        theta_rad=motion.theta,
        theta_std_rad=float(deviations[2]) if len(deviations) == 3 else 0.0,
        residual_std_grey=measurement.evaluation.grey[motion.camera].residual_std,
        noise_grey=measurement.noise[motion.camera],
    )
