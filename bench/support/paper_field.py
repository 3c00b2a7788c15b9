"""The displacement of an open-hole beam in pure bending, exact in an infinite plate."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ddic.synth.fields import Bending, Pair

# Nearer the centre than this share of the radius, where there is no matter, the negative powers of the distance
# give way to polynomials, so that the motion is one-to-one there too.
CONTINUED_BELOW = 0.9

# The perturbation in Term's form, without its scale; the factor of the first is Kolosov's constant, put in later.
POWERS = ((0, 2, 2), (2, 0, 2), (4, 0, 4), (4, 0, 3))
FACTORS = (-1.0, 2.0, -2.0)


@dataclass(frozen=True)
class Term:
    """factor z^m conj(z)^n s^-k with s = |z|^2, z in radii of the hole; near the centre s^-k is continued."""

    factor: complex
    m: int
    n: int
    k: int

    def value(self, z: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """The term at points z (n,)."""
        power, _ = _continued(z, self.k)
        return np.asarray(self.factor * z**self.m * z.conj() ** self.n * power)

    def derivatives(self, z: NDArray[np.complex128]) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Its derivatives by z and by conj(z), each (n,)."""
        power, slope = _continued(z, self.k)
        m, n, bar = self.m, self.n, z.conj()
        by_z = (m * z ** (m - 1) * bar**n if m else 0.0) * power + z**m * bar ** (n + 1) * slope
        by_bar = (n * z**m * bar ** (n - 1) if n else 0.0) * power + z ** (m + 1) * bar**n * slope
        return np.asarray(self.factor * by_z), np.asarray(self.factor * by_bar)


@dataclass(frozen=True)
class OpenHoleBeam:
    """Pure bending along x of a plate with a free circular hole on the neutral axis, in plane stress.

    curvature: of the neutral axis, 1/px; center, radius: of the hole, pixels; poisson_ratio: no unit.
    Exact for r >= 0.9 radius; nearer the centre a continuation with a continuous gradient. A beam of finite height
    would add what its edges change, of the order of (2 radius / height)^4.

    Source: Kolosov-Muskhelishvili's potentials phi = a (z^2 + R^4 / z^2), psi = -a (z^2 - R^4 / z^2 + 2 R^6 / z^4)
    with a = -i sigma' / 8 (sigma' = slope of sigma_x over y), whose traction vanishes on |z| = R.
    """

    curvature: float
    center: Pair
    radius: float
    poisson_ratio: float = 0.3

    def displacement(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Displacement at points (n, 2), pixels."""
        z = self._reduced(points)
        w = np.sum([term.value(z) for term in self._terms], axis=0)
        return np.asarray(self._bending.displacement(points) + np.column_stack([np.real(w), np.imag(w)]))

    def gradient(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Gradient at points (n, 2), shape (n, 2, 2)."""
        z = self._reduced(points)
        pairs = [term.derivatives(z) for term in self._terms]
        by_z, by_bar = (np.sum([pair[k] for pair in pairs], axis=0) / self.radius for k in range(2))
        by_x, by_y = by_z + by_bar, 1j * (by_z - by_bar)
        rows = np.array([[np.real(by_x), np.real(by_y)], [np.imag(by_x), np.imag(by_y)]])
        return np.asarray(self._bending.gradient(points) + np.moveaxis(rows, 2, 0))

    @cached_property
    def _bending(self) -> Bending:
        return Bending(self.curvature, self.center, self.poisson_ratio)

    @cached_property
    def _terms(self) -> tuple[Term, ...]:
        nu = self.poisson_ratio
        scale = -1j * self.curvature * (1 + nu) * self.radius**2 / 8
        factors = ((3 - nu) / (1 + nu), *FACTORS)
        return tuple(Term(scale * f, *powers) for f, powers in zip(factors, POWERS, strict=True))

    def _reduced(self, points: NDArray[np.float64]) -> NDArray[np.complex128]:
        x, y = ((points - np.array(self.center)) / self.radius).T
        return np.asarray(x + 1j * y)


def _continued(z: NDArray[np.complex128], k: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """s^-k and its derivative by s, s = |z|^2; below the limit a parabola in s with the same value and slope there."""
    s, limit = np.abs(z) ** 2, CONTINUED_BELOW**2
    outer, inner = np.maximum(s, limit), np.minimum(s, limit)
    slope = -k * outer ** (-k - 1)
    return outer**-k + slope * (inner**2 - limit**2) / (2 * limit), slope * inner / limit
