"""An exact image pair about the tip of a crack: Williams' field of an inclined crack that ends inside."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from accept.support.opened_pair import picture
from ddic.fracture.crack_tip import evaluate_williams_series, find_kolosov_constant
from ddic.synth.speckle import SpeckleTexture

Array = NDArray[np.float64]

ORDERS = np.array([1, 2])
ROUNDS = 80
"""Steps of the fixed point that finds where a pixel came from; the strain is below 0.1 beyond 2 px of the tip."""


@dataclass(frozen=True, eq=False)
class Crack:
    """A crack; the factors are over the shear modulus.

    Attributes
    ----------
    tip : (2,) array
        Pixels.
    angle : float
        Radians.
    opening_factor, sliding_factor : float
        K_I / mu and K_II / mu, px^(1/2).
    t_stress : float
        T / mu.
    """

    tip: Array = field(default_factory=lambda: np.array([500.3, 520.7]))
    angle: float = float(np.deg2rad(17.0))
    opening_factor: float = 0.2
    sliding_factor: float = 0.0
    t_stress: float = 1e-3

    @property
    def along(self) -> Array:
        """Direction ahead of the tip."""
        return np.array([np.cos(self.angle), np.sin(self.angle)])

    def displacement(self, points: Array) -> Array:
        """Williams' field at points (n, 2), plane stress, nu = 0.3; pixels."""
        axes = np.stack([self.along, [-self.along[1], self.along[0]]])
        root = 2 * np.sqrt(2 * np.pi)
        coefficients = [self.opening_factor / root, self.t_stress / 8, -self.sliding_factor / root, 0.0]
        terms = evaluate_williams_series((points - self.tip) @ axes.T, ORDERS, find_kolosov_constant(0.3, "stress"))
        return np.asarray(terms @ coefficients @ axes)


def render_crack(crack: Crack, size: int, noise: float, seed: int = 0) -> tuple[NDArray[Any], NDArray[Any]]:
    """Draw both images, 16 bit, reference speckle.

    Parameters
    ----------
    crack : Crack
        What opens.
    size : int
        Side of the images, pixels.
    noise : float
        Standard deviation, grey levels of 256.
    seed : int
        Of the speckle and the noise.

    Returns
    -------
    reference, deformed : (size, size) uint16 array
        In the gap between the faces, the deformed image shows anything.
    """
    texture, random = SpeckleTexture(3 + seed), np.random.default_rng(seed)
    y, x = np.mgrid[0:size, 0:size].astype(float)
    points = np.column_stack([x.ravel(), y.ravel()])
    origins = points
    for _ in range(ROUNDS):
        origins = points - crack.displacement(origins)
    return (picture(texture, points, 16, noise * random.standard_normal(len(points))).reshape(size, size),
            picture(texture, origins, 16, noise * random.standard_normal(len(points))).reshape(size, size))
