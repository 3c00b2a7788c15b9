"""Exact pairs of large deformations, what is measured on them, and the noise floor that can be reached."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

import ddic
from accept.support.opened_pair import picture
from ddic.functionals.correlation import read_correlation
from ddic.images.binned import ArraySource
from ddic.images.sub_image import MaskedSource
from ddic.kinematics.strain import compute_strain
from ddic.mesh.plane import build_rotation
from ddic.synth.render import find_reference_points
from ddic.synth.speckle import SpeckleTexture

Array = NDArray[np.float64]
Pair = tuple[NDArray[Any], NDArray[Any]]

STEP = 1e-3
"""Half of the distance, pixels, over which gradients are taken; they only lead the search for where a pixel was."""


@dataclass(frozen=True, eq=False)
class Deformation:
    """A displacement known everywhere.

    Attributes
    ----------
    displacement : callable
        From points (n, 2) to their displacement (n, 2), pixels.
    """

    displacement: Callable[[Array], Array]

    def gradient(self, points: Array) -> Array:
        """du_i/dx_j at points (n, 2), (n, 2, 2)."""
        columns = []
        for axis in range(2):
            step = np.zeros(2)
            step[axis] = STEP
            change = self.displacement(points + step) - self.displacement(points - step)
            columns.append(change / (2 * STEP))
        return np.stack(columns, axis=2)


@dataclass(frozen=True)
class Camera:
    """What the pictures are like.

    Attributes
    ----------
    size : (width, height)
        Pixels.
    noise : float
        Standard deviation, grey levels of 256.
    bits : int
        8 or 16.
    speckle : float
        Size of the speckles, times the reference size.
    seed : int
        Of the speckles and of the noise.
    """

    size: tuple[int, int]
    noise: float = 2.0
    bits: int = 8
    speckle: float = 1.0
    seed: int = 3


def make_linear(gradient: Array, centre: Array, translation: Array | None = None) -> Deformation:
    """Make a homogeneous deformation.

    Parameters
    ----------
    gradient : (2, 2) array
        du_i/dx_j.
    centre : (2,) array
        Pixels.
    translation : (2,) array, optional
        Of the centre, pixels; none by default.

    Returns
    -------
    Deformation
        Displacement gradient (x - centre) + translation.
    """
    moved = np.zeros(2) if translation is None else translation
    return Deformation(lambda points: np.asarray((points - centre) @ gradient.T + moved))


def make_rotation(degrees: float, scale: float = 1.0) -> Array:
    """Make the displacement gradient of a rotation with a scale.

    Parameters
    ----------
    degrees : float
        From x towards y.
    scale : float
        Times which lengths grow.

    Returns
    -------
    (2, 2) array
        scale R - I.
    """
    return np.asarray(scale * build_rotation(np.deg2rad(degrees)) - np.eye(2))


def render_deformed(deformation: Deformation, camera: Camera) -> Pair:
    """Draw both images, without interpolation.

    Parameters
    ----------
    deformation : Deformation
        Of the reference image.
    camera : Camera
        What the pictures are like.

    Returns
    -------
    reference, deformed : (height, width) array
        uint8 or uint16.
    """
    width, height = camera.size
    texture, random = SpeckleTexture(camera.seed, size_factor=camera.speckle), np.random.default_rng(camera.seed)
    y, x = np.mgrid[0:height, 0:width].astype(float)
    points = np.column_stack([x.ravel(), y.ravel()])
    drawn = []
    for origins in (points, find_reference_points(deformation, points)):
        noise = camera.noise * random.standard_normal(len(points))
        drawn.append(picture(texture, origins, camera.bits, noise).reshape(height, width))
    return drawn[0], drawn[1]


@dataclass(frozen=True)
class Measured:
    """What a measurement came to.

    Attributes
    ----------
    rms, largest : float
        Error at the nodes, pixels; nan where it did not converge.
    refusal : str
        Why it was refused; empty where it converged.
    n_iterations : int
        Of Gauss-Newton.
    largest_strain : float
        Green-Lagrange, of any cell; nan where it did not converge.
    """

    rms: float
    largest: float
    refusal: str = ""
    n_iterations: int = 0
    largest_strain: float = np.nan

    @property
    def converged(self) -> bool:
        """Whether it did."""
        return not self.refusal


def measure_deformed(pair: Pair, mesh: ddic.Mesh, deformation: Deformation,
                     options: dict[str, Any] | None = None, start: Any = None) -> Measured:
    """Measure a pair, and compare with what it was drawn with.

    Parameters
    ----------
    pair : tuple of arrays
        The images.
    mesh : Mesh
        Pixels.
    deformation : Deformation
        The truth.
    options : dict, optional
        As ``ddic.measure`` takes them.
    start : Result or pair of arrays, optional
        As ``ddic.measure`` takes it.

    Returns
    -------
    Measured
        Errors, or the refusal.
    """
    try:
        result = ddic.measure(pair, mesh, options=options or {}, start=start)
    except ddic.DdicError as error:
        return Measured(np.nan, np.nan, str(error).splitlines()[0])
    off = result.at(mesh.nodes) - deformation.displacement(mesh.nodes)
    strain = compute_strain(result.mesh, result.displacement.ravel()).green_lagrange
    return Measured(float(np.sqrt(np.mean(off**2))), float(np.linalg.norm(off, axis=1).max()),
                    n_iterations=len(result.gauss_newton["iteration"]), largest_strain=float(np.abs(strain).max()))


def predict_floor(pair: Pair, mesh: ddic.Mesh, deformation: Deformation, noise: float) -> float:
    """Predict the RMS error that noise leaves, with the gradient of the deformed image.

    Parameters
    ----------
    pair : tuple of arrays
        The images.
    mesh : Mesh
        Pixels.
    deformation : Deformation
        The truth.
    noise : float
        Standard deviation, the images' grey levels.

    Returns
    -------
    float
        sqrt(2) sigma sqrt(mean diag M^-1), pixels.
    """
    image = MaskedSource(ArraySource(Path("memory"), np.asarray(pair[0], dtype=np.float32)))
    correlation = read_correlation(mesh, image, 3)
    moved = correlation.with_moved_gradient(deformation.displacement(mesh.nodes).ravel())
    factor = splu(moved.assemble_hessian().tocsc())
    diagonal = np.diag(factor.solve(np.eye(mesh.n_dofs)))
    return float(np.sqrt(2 * noise**2 * diagonal.mean()))
