"""The plate with a circular hole in uniaxial tension (Kirsch)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ddic.errors import InputError
from ddic.synth.fields import Pair, require_finite, require_poisson_ratio

# Nearer the centre than this fraction of the radius, where there is no matter, the negative powers of r give
# way to polynomials, so that the motion is one-to-one there too.
_CONTINUED_BELOW = 0.9


@dataclass(frozen=True)
class Kirsch:
    """Infinite plate with a circular hole, in plane stress, pulled along y.

    Exact for r >= 0.9 radius; nearer the centre a continuation with a continuous gradient, at most 6 strain.

    Source: Kirsch's solution; Cartesian displacements as in Timoshenko & Goodier, Theory of Elasticity.

    Attributes
    ----------
    center : (float, float)
        Of the hole, pixels.
    radius : float
        Of the hole, pixels.
    strain : float
        Far-field stress over Young's modulus, no unit.
    poisson_ratio : float
        No unit.
    translation : (float, float)
        Rigid displacement added, pixels.
    """

    center: Pair = (0.0, 0.0)
    radius: float = 100.0
    strain: float = 0.005
    poisson_ratio: float = 0.3
    translation: Pair = (0.0, 0.0)

    def __post_init__(self) -> None:
        require_finite("kirsch", center=self.center, strain=self.strain, translation=self.translation)
        require_poisson_ratio("kirsch", self.poisson_ratio)
        if not (self.radius > 0 and math.isfinite(self.radius)):
            raise InputError(f"kirsch: radius = {self.radius}: must be positive")

    def displacement(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Evaluate the displacement u.

        Parameters
        ----------
        points : (n, 2) array
            Pixels.

        Returns
        -------
        (n, 2) array
            Pixels.
        """
        across, along = (points - np.array(self.center)).T / self.radius
        h, _, w, _ = _decaying_terms(across**2 + along**2)
        kappa, scale = self._constants()
        p, q = _cubics(along, across)
        # The plate without hole, what decays like 1 / r, and what decays like 1 / r - 1 / r^3.
        u_along = along * ((kappa + 1) + 2 * (1 + kappa) * h) + 2 * p * w
        u_across = across * ((kappa - 3) + 2 * (1 - kappa) * h) + 2 * q * w
        return np.asarray(scale * np.column_stack([u_across, u_along]) + np.array(self.translation))

    def gradient(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Evaluate the gradient du_i/dx_j.

        Parameters
        ----------
        points : (n, 2) array
            Pixels.

        Returns
        -------
        (n, 2, 2) array
            No unit.
        """
        across, along = (points - np.array(self.center)).T / self.radius
        h, dh, w, dw = _decaying_terms(across**2 + along**2)
        kappa, scale = self._constants()
        p, q = _cubics(along, across)
        # Slopes of p and q, times 2 w.
        square = 6 * (along**2 - across**2) * w
        product = 12 * along * across * w
        # Derivatives with respect to r^2, whose own derivative along a direction is twice the coordinate.
        on_along = 2 * (1 + kappa) * dh * along + 2 * p * dw
        on_across = 2 * (1 - kappa) * dh * across + 2 * q * dw
        grad = np.empty((len(points), 2, 2))
        grad[:, 1, 1] = (kappa + 1) + 2 * (1 + kappa) * h + square + 2 * along * on_along
        grad[:, 1, 0] = -product + 2 * across * on_along
        grad[:, 0, 1] = product + 2 * along * on_across
        grad[:, 0, 0] = (kappa - 3) + 2 * (1 - kappa) * h + square + 2 * across * on_across
        return np.asarray(grad * (scale / self.radius))

    def _constants(self) -> tuple[float, float]:
        """Kolosov's constant in plane stress and the displacement scale stress * radius / (8 mu), pixels."""
        nu = self.poisson_ratio
        kappa = (3 - nu) / (1 + nu)
        scale = self.strain * self.radius * (1 + nu) / 4
        return kappa, scale


def _cubics(along: NDArray[np.float64],
            across: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """r^3 cos(3 theta) and r^3 sin(3 theta), theta measured from the direction of the load."""
    p = along * (along**2 - 3 * across**2)
    q = across * (3 * along**2 - across**2)
    return p, q


def _decaying_terms(s: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Return h = 1/s, dh/ds, w = 1/s^2 - 1/s^3, dw/ds for s = (r / radius)^2, continued near the centre.

    Below the limit a function f becomes f(limit) + f'(limit) (s^2 - limit^2) / (2 limit): same value and
    slope at the limit, flat at the centre.
    """
    limit = _CONTINUED_BELOW**2
    outer = np.maximum(s, limit)
    inner = np.minimum(s, limit)
    # Both leave a function as it is beyond the limit, where inner is the limit.
    lever = (inner**2 - limit**2) / (2 * limit)
    fade = inner / limit
    h = 1 / outer
    dh = -1 / outer**2
    w = 1 / outer**2 - 1 / outer**3
    dw = 3 / outer**4 - 2 / outer**3
    return h + dh * lever, dh * fade, w + dw * lever, dw * fade
