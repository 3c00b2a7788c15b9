"""Displacement fields of clean pairs, smooth wherever the images show them, and the points that a motion came from."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from ddic.fracture.crack_tip import evaluate_williams_series, find_kolosov_constant
from ddic.mesh.plane import build_rotation
from ddic.synth.fields import Kirsch

Array = NDArray[np.float64]
Motion = Callable[[Array], Array]
"""Displacement (n, 2) at points (n, 2), pixels."""

ROTATION_DEGREES = 10.0
TRANSLATION = np.array([3.3, -5.6])

CRACK_ABOVE = 50.0
"""Distance of the crack's line from the image's first row, pixels: no image shows the crack."""

INVERSE_PX, MOST_STEPS = 1e-11, 200
"""Where the search for the points that a motion came from ends."""


def make_waves(wavelength: float, strain: float) -> Motion:
    """Make two crossed waves.

    Parameters
    ----------
    wavelength : float
        The shorter, pixels.
    strain : float
        Largest, along x.

    Returns
    -------
    callable
        The displacement.
    """
    amplitude = strain * wavelength / (2 * np.pi)
    short, long = 2 * np.pi / wavelength, 2 * np.pi / (1.25 * wavelength)

    def displacement(points: Array) -> Array:
        x, y = points.T
        along_x = np.sin(short * x + 0.3) * np.cos(long * y - 0.2)
        along_y = np.cos(long * x - 0.7) * np.sin(short * y + 0.5)
        return np.asarray(amplitude * np.column_stack([along_x, 0.8 * along_y]))

    return displacement


def make_hole(centre: Array, radius: float, strain: float) -> Motion:
    """Make a plate with a hole in tension.

    Parameters
    ----------
    centre : (2,) array
        Of the hole, pixels.
    radius : float
        Pixels.
    strain : float
        Far from the hole, along y.

    Returns
    -------
    callable
        The displacement, continued smoothly into the hole.
    """
    return Kirsch((centre[0], centre[1]), radius, strain, 0.3, (TRANSLATION[0], TRANSLATION[1])).displacement


def make_crack(tip_column: float, opening: float) -> Motion:
    """Make the field beside and ahead of a crack that runs along x above the image.

    Parameters
    ----------
    tip_column : float
        Pixels.
    opening : float
        K_I over the shear modulus, half of which is K_II's, px^(1/2).

    Returns
    -------
    callable
        The displacement.
    """
    tip = np.array([tip_column, -CRACK_ABOVE])
    coefficients = opening / (2 * np.sqrt(2 * np.pi)) * np.array([1.0, -0.5])
    kappa = find_kolosov_constant(0.3, "stress")

    def displacement(points: Array) -> Array:
        terms = evaluate_williams_series(points - tip, np.array([1]), kappa)
        return np.asarray(terms @ coefficients)

    return displacement


def make_neck(centre: Array, width: float, strain: float) -> Motion:
    """Make a strain of 1 % along y with a Gaussian neck.

    Parameters
    ----------
    centre : (2,) array
        Pixels.
    width : float
        Standard deviation of the neck, pixels.
    strain : float
        Added in its middle.

    Returns
    -------
    callable
        The displacement, narrower by 0.4 of the strain.
    """

    def displacement(points: Array) -> Array:
        x, y = (points - centre).T
        neck = strain * np.exp(-(y**2) / (2 * width**2))
        stretch = strain * width * np.sqrt(np.pi / 2) * erf(y / (np.sqrt(2) * width))
        return np.column_stack([-0.4 * (0.01 + neck) * x, 0.01 * y + stretch])

    return displacement


def make_turned_waves(centre: Array, wavelength: float, strain: float) -> Motion:
    """Make a rotation with waves on top.

    Parameters
    ----------
    centre : (2,) array
        Of the rotation, pixels.
    wavelength, strain : float
        Of the waves.

    Returns
    -------
    callable
        The displacement.
    """
    turn = build_rotation(np.deg2rad(ROTATION_DEGREES)) - np.eye(2)
    waves = make_waves(wavelength, strain)
    return lambda points: np.asarray((points - centre) @ turn.T + waves(points))


def find_origins(motion: Motion, points: Array) -> Array:
    """Find x with x + u(x) = y by the fixed point x = y - u(x), for gradients well below 1.

    Parameters
    ----------
    motion : callable
        u.
    points : (n, 2) array
        The y, pixels.

    Returns
    -------
    (n, 2) array
        The x, pixels.

    Raises
    ------
    ValueError
        Where it does not come to rest.
    """
    origins = points - motion(points)
    for _ in range(MOST_STEPS):
        nearer = points - motion(origins)
        step = float(np.abs(nearer - origins).max())
        origins = nearer
        if step <= INVERSE_PX:
            return origins
    raise ValueError(f"the motion could not be inverted: the last step was {step:.1e} px")
